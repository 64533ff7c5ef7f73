"use strict";
// A click on a heading sorts its table: upwards, downwards, and a third time as it was. Cells carry what they are sorted by.
for (const table of document.querySelectorAll("table")) {
  const body = table.tBodies[0];
  const original = [...body.rows];
  const heads = [...table.tHead.rows[0].cells];
  const compare = (column) => {
    const key = (row) => row.cells[column].dataset.key;
    const given = original.map(key).filter((text) => text !== "");
    const numeric = given.every((text) => !Number.isNaN(Number(text)));
    return (a, b, sign) => {
      const [left, right] = [key(a), key(b)];
      if (left === "" || right === "") return (left === "") - (right === "");  // no result: last, both ways
      if (!numeric) return sign * left.localeCompare(right, "en", { numeric: true });
      return sign * (Number(left) > Number(right)) - sign * (Number(left) < Number(right));
    };
  };
  heads.forEach((head, column) => {
    head.firstElementChild.addEventListener("click", () => {
      const order = { ascending: "descending", descending: null }[head.getAttribute("aria-sort")];
      const next = order === undefined ? "ascending" : order;
      heads.forEach((other) => other.removeAttribute("aria-sort"));
      const by = compare(column);
      const rows = [...original];
      if (next) {
        head.setAttribute("aria-sort", next);
        rows.sort((a, b) => by(a, b, next === "ascending" ? 1 : -1));
      }
      body.append(...rows);
    });
  });
}
// A list of contents that fills a telephone's screen is folded there.
if (matchMedia("(max-width: 60rem)").matches) document.querySelector("nav details").open = false;
