"use strict";
// Measures the accuracy of the page: compares its canvas with the reference images that the page contains.
const decibels = (value) => (value === null ? "identical" : `${value.toFixed(1)} dB`);

// Returns the PSNR in dB of two arrays of bytes; null if the arrays are equal.
function psnr(drawn, reference) {
  let sum = 0;
  for (let i = 0; i < drawn.length; i += 1) sum += (drawn[i] - reference[i]) ** 2;
  return sum ? 10 * Math.log10(255 * 255 * drawn.length / sum) : null;
}

// Draws test view `k` with the stored settings of the model and returns its bytes.
async function pixelsOf(k) {
  const test = about.tests[k];
  return native.pixels(test.view, test.background, about.view.degree, about.view.own);
}

const references = [];
async function referenceOf(k) {
  references[k] ??= await storedArray(about.tests[k].image, about.arrays[about.tests[k].image]);
  return references[k];
}

let measuredHere = null;  // PSNR of each test view on this device
async function measure() {
  const values = [], chosen = native.wanted;
  const modes = document.querySelectorAll("#settings select:enabled");
  for (const select of modes) select.disabled = true;
  try {
    await native.use(0);  // the official order and sampling
    for (let k = 0; k < about.tests.length; k += 1) {
      byId("verdict").textContent = `Measuring ${k + 1} of ${about.tests.length} ...`;
      values.push(psnr(await pixelsOf(k), await referenceOf(k)));
    }
    measuredHere = values;
    await native.use(chosen);
  } finally {
    for (const select of modes) select.disabled = !native;
  }
  showQuality();
  show();
}

// Returns the lowest PSNR of a list, or null if all images are equal.
const worst = (list) => list.reduce((low, value) => (value !== null && (low === null || value < low) ? value : low), null);

function showQuality() {
  byId("quality").hidden = !about.tests.length;
  const { measured } = about;
  const lines = [];
  if (measured) lines.push(`When this page was written: ${decibels(worst(measured.psnr))} (${measured.by}).`);
  else lines.push("The accuracy was not measured when this page was written.");
  if (measuredHere) lines.push(`On this device: ${decibels(worst(measuredHere))} (${native.name}).`);
  lines.push(`PSNR of this page's images against ${about.against}, in the worst of ${about.tests.length} test views. ` +
    "Above 40 dB differences are invisible.");
  byId("verdict").replaceChildren(...lines.map((text) => Object.assign(document.createElement("div"), { textContent: text })));
  // A table with a row for each test view, and a column for each measurement.
  const head = ["test view", ...(measured ? ["when written"] : []), ...(measuredHere ? ["this device"] : [])];
  const rows = about.tests.map((test, k) => [
    test.name, ...(measured ? [decibels(measured.psnr[k])] : []), ...(measuredHere ? [decibels(measuredHere[k])] : [])]);
  const row = (cells, kind) => {
    const element = document.createElement("tr");
    element.append(...cells.map((text) => Object.assign(document.createElement(kind), { textContent: text })));
    return element;
  };
  const top = document.createElement("thead"), body = document.createElement("tbody");
  top.append(row(head, "th"));
  body.append(...rows.map((cells) => row(cells, "td")));
  byId("views").replaceChildren(top, body);
  byId("views").hidden = head.length === 1;
  byId("measure").hidden = !native;
  byId("costs").textContent = "The model was reduced for this page. PSNR after each step, against the images before it: " +
    about.costs.map((cost) => `${cost.what}: ${decibels(cost.psnr)}.`).join(" ");
  byId("costs").hidden = !about.costs.length;
}
byId("measure").addEventListener("click", async () => {
  byId("measure").disabled = true;
  try { await measure(); } catch (error) { byId("verdict").textContent = `The measurement failed: ${error.message || error}`; }
  byId("measure").disabled = false;
});
