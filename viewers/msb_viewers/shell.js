"use strict";
// This page was written by `msb view --html` or `msb compare --html`. The page loads no other files.
const meta = JSON.parse(document.getElementById("meta").textContent);
const byId = (id) => document.getElementById(id);
const make = (tag, text, name) => {
  const node = document.createElement(tag);
  if (text !== undefined) node.textContent = text;
  if (name) node.className = name;
  return node;
};
const say = (text) => { byId("status").textContent = text; byId("status").hidden = !text; };
function showKeys(rows) {
  const box = byId("help"), list = make("dl");
  box.hidden = !box.hidden;
  for (const [key, text] of rows) list.append(make("dt", key), make("dd", text));
  box.replaceChildren(make("b", "Keys and mouse"), list);
}
