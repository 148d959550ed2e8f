// Filament: its glTF loader, renderer and view as they begin.
"use strict";
obey(async (canvas, file) => {
  Object.assign(window, glMatrix);  // it expects the names of an older one
  await new Promise((done) => Filament.init([], done));
  const engine = Filament.Engine.create(canvas);
  const [scene, view, renderer, chain] =
    [engine.createScene(), engine.createView(), engine.createRenderer(), engine.createSwapChain()];
  const camera = engine.createCamera(Filament.EntityManager.get().create());
  view.setCamera(camera);
  view.setScene(scene);
  view.setViewport([0, 0, canvas.width, canvas.height]);
  renderer.setClearOptions({ clearColor: [0, 0, 0, 1], clear: true });
  const asset = engine.createAssetLoader().createAsset(new Uint8Array(await (await fetch(file)).arrayBuffer()));
  await new Promise((done) => asset.loadResources(done, null, "", 1));
  scene.addEntities(asset.getEntities());
  if (mended) {
    const linear = Filament.ColorGrading.Builder().toneMapping(Filament.ColorGrading$ToneMapping.LINEAR);
    view.setColorGrading(linear.build(engine));
    view.setAntiAliasing(Filament.View$AntiAliasing.NONE);
  }
  return async (wanted) => {
    const aspect = canvas.width / canvas.height;
    camera.setProjectionFov(wanted.degrees, aspect, wanted.near, wanted.far, Filament.Camera$Fov.VERTICAL);
    camera.lookAt(wanted.eye, wanted.target, [0, 1, 0]);
    // It skips frames; the last image stays until the browser shows it.
    for (let frames = 0; frames < 3;) {
      await new Promise(requestAnimationFrame);
      const begun = renderer.beginFrame(chain);
      if (begun) {
        renderer.renderView(view);
        renderer.endFrame();
        frames += 1;
      }
      engine.execute();
    }
  };
});
