"use strict";
// In pages of a mesh, this script selects the interpretation of colours, and opens files that are dropped or chosen.
byId("colors").addEventListener("change", (event) => { setColors(event.target.value); show(); });
window.addEventListener("dragover", (event) => { event.preventDefault(); document.body.classList.add("over"); });
window.addEventListener("dragleave", () => document.body.classList.remove("over"));
window.addEventListener("drop", (event) => {
  event.preventDefault();
  document.body.classList.remove("over");
  if (event.dataTransfer.files.length) openFile(event.dataTransfer.files[0]);
});
byId("file").addEventListener("change", (event) => event.target.files.length && openFile(event.target.files[0]));

async function openFirst() {
  const url = query.get("url");
  try {
    if (url) {
      const answer = await fetch(url);
      if (!answer.ok) throw new Error(`status ${answer.status}`);
      await open(await answer.arrayBuffer(), start.name || url.split("/").pop());
    } else {
      const file = embeddedFile();
      if (!file) { say("Drop a .glb file here"); return false; }
      await open(file, start.name, start.sphere);
    }
  } catch (error) {
    say(`${url || start.name} cannot be shown: ${error.message || error}`);
    return false;
  }
  return true;
}
