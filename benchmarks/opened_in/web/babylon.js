// Babylon.js: an engine, a scene and the glTF loader.
"use strict";
obey(async (canvas, file) => {
  const engine = new BABYLON.Engine(canvas, true, { useExactSrgbConversions: mended });
  BABYLON.MeshoptCompression.Configuration = { decoder: { url: "meshopt_decoder.js" } };
  const scene = new BABYLON.Scene(engine);
  scene.useRightHandedSystem = true;
  scene.clearColor = new BABYLON.Color4(0, 0, 0, 1);
  const camera = new BABYLON.FreeCamera("view", BABYLON.Vector3.Zero(), scene);
  await BABYLON.AppendSceneAsync(file, scene);
  scene.activeCamera = camera;
  if (mended) for (const texture of scene.textures) texture.anisotropicFilteringLevel = 1;
  return async (view) => {
    camera.position = BABYLON.Vector3.FromArray(view.eye);
    camera.setTarget(BABYLON.Vector3.FromArray(view.target));
    camera.fov = view.degrees * Math.PI / 180;
    camera.minZ = view.near;
    camera.maxZ = view.far;
    await scene.whenReadyAsync();
    scene.render();
  };
});
