// PlayCanvas: an application, the file as a container asset, a camera.
"use strict";
obey(async (canvas, file) => {
  const app = new pc.Application(canvas, { graphicsDeviceOptions: {} });
  app.autoRender = false;
  if (mended) {
    const chunks = pc.ShaderChunks.get(app.graphicsDevice, pc.SHADERLANGUAGE_GLSL);
    const exact = "mix(12.92 * color, 1.055 * pow(color, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, color))";
    chunks.set("gammaPS", chunks.get("gammaPS").replace("pow(color + 0.0000001, vec3(1.0 / 2.2))", exact));
  }
  app.start();
  const asset = new pc.Asset("model", "container", { url: file });
  await new Promise((done, failed) => {
    asset.on("load", done);
    asset.on("error", failed);
    app.assets.add(asset);
    app.assets.load(asset);
  });
  app.root.addChild(asset.resource.instantiateRenderEntity());
  const camera = new pc.Entity();
  camera.addComponent("camera", { clearColor: new pc.Color(0, 0, 0) });
  app.root.addChild(camera);
  return async (view) => {
    app.graphicsDevice.resizeCanvas(canvas.width, canvas.height);
    Object.assign(camera.camera, { fov: view.degrees, nearClip: view.near, farClip: view.far });
    camera.setPosition(...view.eye);
    camera.lookAt(...view.target);
    for (let frame = 0; frame < 3; frame += 1) {
      app.renderNextFrame = true;
      await new Promise((done) => app.once("frameend", done));
    }
  };
});
