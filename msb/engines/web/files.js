"use strict";
// What only the page of a mesh file has: colours by two rules, and files that are dropped.
byId("colors").addEventListener("change", (event) => { setColors(event.target.value); show(); });
window.addEventListener("dragover", (event) => { event.preventDefault(); document.body.classList.add("over"); });
window.addEventListener("dragleave", () => document.body.classList.remove("over"));
window.addEventListener("drop", (event) => {
  event.preventDefault();
  document.body.classList.remove("over");
  if (event.dataTransfer.files.length) openFile(event.dataTransfer.files[0]);
});
byId("file").addEventListener("change", (event) => event.target.files.length && openFile(event.target.files[0]));

async function openFirst(asked) {
  const url = asked.get("url");
  try {
    if (url) {
      const answer = await fetch(url);
      if (!answer.ok) throw new Error(`status ${answer.status}`);
      await open(await answer.arrayBuffer(), start.name || url.split("/").pop());
    } else {
      const own = ownFile();
      if (!own) { say("Drop a .glb here"); return false; }
      await open(own, start.name);
    }
  } catch (error) {
    say(`${url || start.name} cannot be shown: ${error.message || error}`);
    return false;
  }
  return true;
}
