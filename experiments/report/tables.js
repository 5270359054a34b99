// Tables: sorted by a click on a heading, groups of columns shown and hidden.
for (const table of document.querySelectorAll("table.sortable")) {
  const body = table.tBodies[0], original = [...body.rows];
  const heads = [...table.querySelectorAll("thead tr:last-child th")];
  heads.forEach((head, column) => head.querySelector("button")?.addEventListener("click", () => {
    const before = head.getAttribute("aria-sort"), first = head.dataset.first || "ascending";
    const next = !before ? first : before === first ? (first === "ascending" ? "descending" : "ascending") : null;
    heads.forEach(h => h.removeAttribute("aria-sort"));
    if (!next) return body.append(...original);
    head.setAttribute("aria-sort", next);
    const sign = next === "ascending" ? 1 : -1;
    const key = row => {
      const cell = row.cells[column], value = cell.dataset.value;
      return value === undefined ? cell.textContent.trim().toLowerCase() : value === "" ? NaN : Number(value);
    };
    const order = (a, b) => {
      if (typeof a === "string") return sign * a.localeCompare(b);
      if (Number.isNaN(a) || Number.isNaN(b)) return Number.isNaN(a) - Number.isNaN(b);  // what is missing stays below
      return a === b ? 0 : sign * (a < b ? -1 : 1);
    };
    body.append(...original.map(row => [key(row), row]).sort((a, b) => order(a[0], b[0])).map(pair => pair[1]));
  }));
}

for (const switches of document.querySelectorAll(".switches")) {
  const table = document.getElementById(switches.dataset.table);
  for (const box of switches.querySelectorAll("input")) {
    const set = () => table.classList.toggle("without-" + box.value, !box.checked);
    if (innerWidth < 700 && !box.hasAttribute("data-first")) box.checked = false;
    box.addEventListener("change", set);
    set();
  }
}
