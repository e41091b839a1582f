// Lets a reader sort and filter the table of claims, and that of the open points. Without it the
// tables are whole.
document.addEventListener("DOMContentLoaded", () => {
  const table = document.querySelector("table.claims");
  if (!table) {
    return;
  }
  const body = table.tBodies[0];
  const rows = [...body.rows];
  const first = (row, column) => row.cells[column].querySelector("p")?.textContent.trim() ?? "";
  const kind = (row) => row.cells[0].querySelector(".claim-note").textContent.trim();
  const verdict = (row) => first(row, 4);
  const headings = [...table.tHead.rows[0].cells];
  const called = headings.map((heading) => heading.textContent.trim().toLowerCase());

  // filters
  const bar = document.createElement("div");
  bar.className = "claims-filter";
  const search = document.createElement("input");
  search.type = "search";
  search.placeholder = `Search the ${called[0]}s`;
  search.setAttribute("aria-label", search.placeholder);
  const shown = document.createElement("output");
  const choice = (label, of) => {
    const select = document.createElement("select");
    select.setAttribute("aria-label", label);
    const found = [...new Set(rows.map(of))];
    select.append(new Option(label, ""), ...found.map((one) => new Option(one, one)));
    return select;
  };
  const kinds = choice("Every kind", kind);
  const verdicts = choice(`Every ${called[4]}`, verdict);
  const filter = () => {
    const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
    for (const row of rows) {
      const text = row.textContent.toLowerCase();
      row.hidden =
        (kinds.value && kind(row) !== kinds.value) ||
        (verdicts.value && verdict(row) !== verdicts.value) ||
        !words.every((word) => text.includes(word));
    }
    shown.textContent = `${rows.filter((row) => !row.hidden).length} of ${rows.length}`;
  };
  bar.append(search, kinds, verdicts, shown);
  bar.addEventListener("input", filter);
  (table.closest(".pst-scrollable-table-container") ?? table).before(bar);
  filter();

  // on paper nothing can be unfolded
  let folded = [];
  window.addEventListener("beforeprint", () => {
    folded = [...table.querySelectorAll("details:not([open])")];
    folded.forEach((one) => { one.open = true; });
  });
  window.addEventListener("afterprint", () => folded.forEach((one) => { one.open = false; }));

  // sorting: numbers by size, before what is none; words by the alphabet
  const size = (text) => Number.parseFloat(text.replace("\u2212", "-").replace(/^[<(]\s*/, ""));
  const compare = (a, b) => {
    const [x, y] = [size(a), size(b)];
    if (Number.isNaN(x) || Number.isNaN(y)) {
      return Number.isNaN(x) - Number.isNaN(y) || a.localeCompare(b);
    }
    return x - y;
  };
  headings.forEach((heading, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...heading.querySelector("p").childNodes);
    heading.querySelector("p").replaceChildren(button);
    button.addEventListener("click", () => {
      const down = heading.getAttribute("aria-sort") === "ascending";
      headings.forEach((one) => one.removeAttribute("aria-sort"));
      heading.setAttribute("aria-sort", down ? "descending" : "ascending");
      const sign = down ? -1 : 1;
      rows.sort((a, b) => sign * compare(first(a, column), first(b, column)));
      body.append(...rows);
    });
  });
});
