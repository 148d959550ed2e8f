"use strict";
// How faithful the page is: its canvas's pixels against the reference images that it holds.
const decibels = (value) => (value === null ? "equal" : `${value.toFixed(1)} dB`);

function psnr(found, wanted) {
  let sum = 0;
  for (let i = 0; i < found.length; i += 1) sum += (found[i] - wanted[i]) ** 2;
  return sum ? 10 * Math.log10(255 * 255 * found.length / sum) : null;
}

// The bytes of test view `k` as this page draws them, with the settings of the model.
async function pixelsOf(k) {
  const test = about.tests[k];
  return official.pixels(test.view, test.background, about.view.degree, about.view.own);
}

const references = [];
async function referenceOf(k) {
  references[k] ??= await storedArray(about.tests[k].image, about.arrays[about.tests[k].image]);
  return references[k];
}

let here = null;
async function measure() {
  const found = [], chosen = official.wanted;
  const modes = document.querySelectorAll("#settings select:enabled");
  for (const select of modes) select.disabled = true;
  try {
    await official.use(0);  // the official order and sampling
    for (let k = 0; k < about.tests.length; k += 1) {
      byId("verdict").textContent = `Measuring ${k + 1} of ${about.tests.length} ...`;
      found.push(psnr(await pixelsOf(k), await referenceOf(k)));
    }
    here = found;
    await official.use(chosen);
  } finally {
    for (const select of modes) select.disabled = !official;
  }
  showFaithful();
  show();
}

const worst = (list) => list.reduce((low, value) => (value !== null && (low === null || value < low) ? value : low), null);

function showFaithful() {
  byId("faithful").hidden = !about.tests.length;
  const made = about.measured;
  const lines = [];
  if (made) lines.push(`${decibels(worst(made.psnr))} when made, by ${made.by}.`);
  else lines.push("Not measured when this page was made.");
  if (here) lines.push(`${decibels(worst(here))} here, by ${official.name}.`);
  lines.push(`This is the PSNR of this page's pixels to ${about.against}, in the worst of ${about.tests.length} views.`);
  byId("verdict").replaceChildren(...lines.map((text) => Object.assign(document.createElement("div"), { textContent: text })));
  const head = ["view", ...(made ? ["when made"] : []), ...(here ? ["here"] : [])];
  const rows = about.tests.map((test, k) =>
    [test.name, ...(made ? [decibels(made.psnr[k])] : []), ...(here ? [decibels(here[k])] : [])]);
  const row = (cells, kind) => {
    const made_ = document.createElement("tr");
    made_.append(...cells.map((text) => Object.assign(document.createElement(kind), { textContent: text })));
    return made_;
  };
  const top = document.createElement("thead"), body = document.createElement("tbody");
  top.append(row(head, "th"));
  body.append(...rows.map((cells) => row(cells, "td")));
  byId("views").replaceChildren(top, body);
  byId("views").hidden = head.length === 1;
  byId("measure").hidden = !official;
  byId("costs").textContent = "What the smaller page costs: " +
    about.costs.map((cost) => `${cost.what}: ${decibels(cost.psnr)}.`).join(" ");
  byId("costs").hidden = !about.costs.length;
}
byId("measure").addEventListener("click", async () => {
  byId("measure").disabled = true;
  try { await measure(); } catch (error) { byId("verdict").textContent = `It cannot be measured: ${error.message || error}`; }
  byId("measure").disabled = false;
});
