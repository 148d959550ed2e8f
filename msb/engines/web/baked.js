"use strict";
// What only the page of a bake has: its files to choose from, what it lost, and what it is.
const files = Object.fromEntries([...document.querySelectorAll("script[data-file]")]
  .map((element) => [element.dataset.file, element]));

const made = (kind, text) => Object.assign(document.createElement(kind), { textContent: text });
function row(cells, kind) {
  const found = document.createElement("tr");
  found.append(...cells.map((text) => made(kind, text)));
  return found;
}

function tell(bake) {
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
  byId("about").replaceChildren(...bake.facts.flatMap(([term, text]) => [made("dt", term), made("dd", text)]));
  byId("notes").previousElementSibling.hidden = !bake.notes.length;
  byId("notes").replaceChildren(...bake.notes.map((text) => made("li", text)));
}

const openNamed = (name) => open(bytesOf(files[name].textContent), name);

async function openFirst() {
  tell(start.baked);
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
