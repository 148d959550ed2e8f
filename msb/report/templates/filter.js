// Add lists that filter the rows of a table by group, by row heading, or by a column marked data-filter.
for (const table of document.querySelectorAll("table")) {
  const columns = [...table.querySelectorAll("[data-filter]")];
  if (!columns.length) continue;
  const bar = document.createElement("div");
  bar.className = "filters";
  table.closest(".scroll").before(bar);
  const group = (row) => row.parentElement.querySelector(".group").textContent.trim();
  const label = table.querySelector("thead th.label").textContent.trim();
  // Each filter list has a title, and a function that returns the value of a row.
  const filters = [["Dataset, scene", group], [label, (row) => row.cells[0].textContent.trim()]];
  for (const head of columns) {
    const place = Number(head.dataset.column) + 1;
    filters.push([head.textContent.trim(), (row) => row.cells[place].textContent.trim()]);
  }
  const rows = [...table.querySelectorAll("tbody tr:not(.group)")];
  const lists = filters.map(([name, of]) => {
    const holder = document.createElement("label");
    const list = document.createElement("select");
    holder.append(name, list);
    list.append(new Option("all", ""));
    for (const value of new Set(rows.map(of))) list.append(new Option(value, value));
    list.addEventListener("change", apply);
    bar.append(holder);
    return [list, of];
  });
  const count = document.createElement("output");
  bar.append(count);
  function apply() {
    for (const row of rows) row.hidden = lists.some(([list, of]) => list.value && list.value !== of(row));
    for (const body of table.tBodies) {
      const bodyRows = [...body.querySelectorAll("tr:not(.group)")];
      body.hidden = bodyRows.every((row) => row.hidden);
    }
    count.value = `${rows.filter((row) => !row.hidden).length} of ${rows.length} rows`;
  }
  apply();
}
