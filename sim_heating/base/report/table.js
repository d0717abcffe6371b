"use strict";
// Sorts the rows of a table by the heads of its columns, and filters them by a text and by the values of some columns.
(() => {
  const collator = new Intl.Collator("en", { numeric: true, sensitivity: "base" });

  for (const tools of document.querySelectorAll(".tools")) {
    const table = document.getElementById(tools.dataset.rows);
    const body = table.tBodies[0], rows = [...body.rows], heads = [...table.tHead.rows[0].cells];
    rows.forEach((row, i) => { row.dataset.place = i; });
    const text = element("input", tools, { type: "search", placeholder: "Filter rows", "aria-label": "Filter rows by words" });
    const choices = heads.flatMap((head, k) => {
      if (!head.dataset.choice) return [];
      const name = head.textContent;
      const select = element("select", tools, { "aria-label": `Filter by ${name}` });
      element("option", select, { value: "", text: `${name}: all` });
      const values = [...new Set(rows.map((row) => row.cells[k].textContent))].sort(collator.compare);
      for (const value of values) element("option", select, { value, text: value });
      return [[select, k]];
    });
    const count = element("span", tools, { role: "status", class: "soft" });

    const filter = () => {
      const words = text.value.toLowerCase().split(/\s+/).filter(Boolean);
      let shown = 0;
      for (const row of rows) {
        const whole = row.textContent.toLowerCase();
        row.hidden = !(words.every((w) => [...row.cells].some((c) => c.textContent.toLowerCase().includes(w)) || whole.includes(w))
          && choices.every(([select, k]) => !select.value || row.cells[k].textContent === select.value));
        shown += row.hidden ? 0 : 1;
      }
      count.textContent = shown === rows.length ? `${rows.length} rows` : `${shown} of ${rows.length} rows`;
    };
    text.addEventListener("input", filter);
    for (const [select] of choices) select.addEventListener("change", filter);

    // A number in full where the program wrote one, else that at the beginning of the text ("0.012 +- 0.003"), where all
    // cells of the column begin so.
    const leading = (row, k) => /^[-+]?\.?\d/.test(row.cells[k].textContent);
    const estimates = heads.map((_, k) => rows.some((row) => leading(row, k)) && rows.every((row) => leading(row, k)
      || ["", "-"].includes(row.cells[k].textContent)));
    const value = (row, k) => row.cells[k].dataset.value
      ?? (estimates[k] && leading(row, k) ? String(parseFloat(row.cells[k].textContent)) : undefined);
    const sort = (k) => {
      const ascending = heads[k].getAttribute("aria-sort") !== "ascending";
      heads.forEach((head, i) => head.setAttribute("aria-sort", i !== k ? "none" : ascending ? "ascending" : "descending"));
      const numbers = rows.some((row) => value(row, k) !== undefined);
      const order = (a, b) => {
        if (!numbers) return collator.compare(a.cells[k].textContent, b.cells[k].textContent);
        const [x, y] = [value(a, k), value(b, k)];
        // what is no number comes last, whichever way the others are sorted
        if (x === undefined || y === undefined) return ascending ? (x === undefined) - (y === undefined) : (y === undefined) - (x === undefined);
        return Number(x) - Number(y);
      };
      rows.sort((a, b) => (ascending ? order(a, b) : order(b, a)) || a.dataset.place - b.dataset.place);
      body.append(...rows);
    };
    heads.forEach((head, k) => {
      const name = head.textContent;
      head.textContent = "";
      head.setAttribute("aria-sort", "none");
      element("button", head, { type: "button", text: name, title: `Sort by ${name}` }).addEventListener("click", () => sort(k));
    });
    tools.classList.add("on");
    filter();
  }
})();
