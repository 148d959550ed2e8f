// Galacean Engine: an engine, the file as its resource, a camera.
"use strict";
obey(async (canvas, file) => {
  const { Camera, Color, Vector3, WebGLEngine } = Galacean;
  const engine = await WebGLEngine.create({ canvas });
  const scene = engine.sceneManager.activeScene;
  scene.background.solidColor = new Color(0, 0, 0, 1);
  const root = scene.createRootEntity();
  root.addChild((await engine.resourceManager.load(file)).instantiateSceneRoot());
  const place = root.createChild();
  const camera = place.addComponent(Camera);
  return (view) => {
    place.transform.setPosition(...view.eye);
    place.transform.lookAt(new Vector3(...view.target));
    Object.assign(camera, { fieldOfView: view.degrees, nearClipPlane: view.near, farClipPlane: view.far });
    engine.update();
  };
});
