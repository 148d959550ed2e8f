"use strict";
// The page of a bake: the list of its mesh files, a table of the loss of quality, facts and notes.
const files = Object.fromEntries([...document.querySelectorAll("script[data-file]")]
  .map((script) => [script.dataset.file, script]));

const element = (kind, text) => Object.assign(document.createElement(kind), { textContent: text });
function row(cells, kind) {
  const result = document.createElement("tr");
  result.append(...cells.map((text) => element(kind, text)));
  return result;
}

function showReport(bake) {
  byId("file-shown").append(...Object.keys(files).map((name) => new Option(name, name)));
  byId("file-shown").parentElement.hidden = Object.keys(files).length === 1;
  const [head, ...rows] = bake.losses, top = document.createElement("thead"), body = document.createElement("tbody");
  if (head) top.append(row(head, "th"));
  body.append(...rows.map((cells) => row(cells, "td")));
  byId("losses").replaceChildren(top, body);
  byId("losses").hidden = !head;
  byId("preview").src = bake.preview;
  byId("preview").alt = byId("caption").textContent = bake.caption;
  byId("preview").addEventListener("click", () => byId("preview").classList.toggle("large"));
  byId("about").replaceChildren(...bake.facts.flatMap(([term, text]) => [element("dt", term), element("dd", text)]));
  byId("notes").previousElementSibling.hidden = !bake.notes.length;
  byId("notes").replaceChildren(...bake.notes.map((text) => element("li", text)));
}

const openNamed = (name) => open(decodeBase64(files[name].textContent), name, start.sphere);

async function openFirst() {
  showReport(start.baked);
  const [first] = Object.keys(files);
  try {
    await openNamed(first);
  } catch (error) {
    say(`${first} cannot be shown: ${error.message || error}`);
    return false;
  }
  return true;
}

byId("file-shown").addEventListener("change", async (event) => { await openNamed(event.target.value); show(); });
