"use strict";
// A click on a heading sorts the rows of each group. Rows without a number stay last. A row of the paper
// stays below the matching row of ours.
for (const table of document.querySelectorAll("table")) {
  for (const button of table.querySelectorAll("thead button")) {
    button.addEventListener("click", () => {
      const heading = button.closest("th");
      const descending = heading.getAttribute("aria-sort") !== "descending";
      for (const other of table.querySelectorAll("[aria-sort]")) other.removeAttribute("aria-sort");
      heading.setAttribute("aria-sort", descending ? "descending" : "ascending");
      for (const body of table.tBodies) sort(body, Number(heading.dataset.column), descending);
    });
  }
}

function sort(body, column, descending) {
  const units = [];
  for (const row of body.rows) {
    if (row.classList.contains("group")) continue;
    if (row.classList.contains("paper") && units.length) units.at(-1).push(row);
    else units.push([row]);
  }
  const value = (unit) => {
    const text = unit[0].cells[column + 1].dataset.value;
    return text === undefined ? NaN : Number(text);
  };
  units.sort((a, b) => {
    const [x, y] = [value(a), value(b)];
    if (Number.isNaN(x) || Number.isNaN(y)) return Number.isNaN(x) - Number.isNaN(y);
    return descending ? y - x : x - y;
  });
  for (const unit of units) body.append(...unit);
}

const checkbox = document.getElementById("paper");
if (checkbox) checkbox.addEventListener("change", () => document.body.classList.toggle("plain", !checkbox.checked));
