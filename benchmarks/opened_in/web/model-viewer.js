// <model-viewer>: the element, its file, a camera on an orbit.
obey(async (canvas, file) => async (view) => {
  customElements.get("model-viewer").minimumRenderScale = 1;  // however slow the machine is
  customElements.get("model-viewer").meshoptDecoderLocation = "meshopt_decoder.js";
  const viewer = document.createElement("model-viewer");
  // It draws only the part of the page inside the window.
  const place = { position: "absolute", top: 0, left: 0, background: "black" };
  Object.assign(viewer.style, place, { width: `${canvas.width}px`, height: `${canvas.height}px` });
  const [x, y, z] = view.eye.map((value, axis) => value - view.target[axis]);
  const radius = Math.hypot(x, y, z);
  const asked = {
    loading: "eager", "min-camera-orbit": "auto 0deg 0m", "max-camera-orbit": `auto 180deg ${radius}m`,
    "min-field-of-view": "1deg", "max-field-of-view": "179deg", "field-of-view": `${view.degrees}deg`,
    "camera-target": view.target.map((value) => `${value}m`).join(" "),
    "camera-orbit": `${Math.atan2(x, z)}rad ${Math.acos(y / radius)}rad ${radius}m`, src: file,
  };
  for (const [name, value] of Object.entries(asked)) viewer.setAttribute(name, value);
  const loaded = new Promise((done, failed) => {
    viewer.addEventListener("load", done);
    viewer.addEventListener("error", ({ detail }) => failed(detail.sourceError || detail.type));
  });
  document.body.append(viewer);
  await loaded;
  viewer.jumpCameraToGoal();
  const context = canvas.getContext("2d", { willReadFrequently: true });
  const isEmpty = () => context.getImageData(canvas.width / 2, canvas.height / 2, 1, 1).data[3] === 0;
  for (let tries = 0; tries < 40 && isEmpty(); tries += 1) {
    await new Promise((done) => setTimeout(done, 500));
    context.drawImage(await createImageBitmap(await viewer.toBlob()), 0, 0, canvas.width, canvas.height);
  }
  context.globalCompositeOperation = "destination-over";
  context.fillRect(0, 0, canvas.width, canvas.height);
});
