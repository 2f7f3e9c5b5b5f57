// Tables of a page: a click on a header sorts, words in the field above filter.
// The wall of thumbnails on the front page: words in the field above filter.
document.addEventListener("DOMContentLoaded", () => {
  for (const field of document.querySelectorAll("input.tiles")) {
    const tiles = [...field.nextElementSibling.children];
    field.addEventListener("input", () => {
      const words = field.value.toLowerCase().split(/\s+/);
      for (const tile of tiles) {
        const text = tile.textContent.toLowerCase();
        tile.hidden = !words.every((word) => text.includes(word));
      }
    });
  }
  // A verdict in the address shows the claims with it, #all shows them all again.
  const claims = [...document.querySelectorAll("table.claims tr[id]")];
  const chosen = () => {
    const kind = location.hash.slice(1);
    const known = ["reproduced", "not-reproduced", "not-decidable"].includes(kind);
    claims.forEach((row) => (row.hidden = known && !row.classList.contains(kind)));
  };
  chosen();
  addEventListener("hashchange", chosen);
  // A folded cell is called what it shows, "Show code".
  // Groups of the left bar are headings of a level; what scrolls is reached by keys.
  document.querySelectorAll(".caption[role=heading]").forEach((part) => part.setAttribute("aria-level", "2"));
  const reached = () => {
    document.querySelectorAll(".announcement, .cell_output, .table-wrapper, pre").forEach((part) => {
      if (part.scrollWidth > part.clientWidth) part.tabIndex = 0;
    });
  };
  reached();
  addEventListener("load", reached);
  addEventListener("resize", reached);
  document.querySelectorAll("summary[aria-label]").forEach((part) => part.removeAttribute("aria-label"));
  // A view in space: its script is loaded when a reader asks for one, and once.
  for (const button of document.querySelectorAll(".turning button")) {
    button.addEventListener("click", () => {
      const view = JSON.parse(button.nextElementSibling.textContent);
      const draw = () => {
        const place = document.createElement("div");
        button.replaceWith(place);
        Plotly.newPlot(place, view.data, view.layout, view.config);
      };
      if (window.Plotly) return draw();
      button.disabled = true;
      const script = document.createElement("script");
      script.src = button.dataset.script;
      script.onload = draw;
      document.head.append(script);
    });
  }
  for (const field of document.querySelectorAll("input.filter")) {
    const table = field.nextElementSibling.querySelector("table");
    const rows = [...table.tBodies[0].rows];
    field.addEventListener("input", () => {
      const words = field.value.toLowerCase().split(/\s+/);
      for (const row of rows) {
        const text = row.textContent.toLowerCase();
        row.hidden = !words.every((word) => text.includes(word));
      }
    });
    [...table.tHead.rows[0].cells].forEach((cell, column) => {
      cell.tabIndex = 0;
      cell.setAttribute("role", "button");
      let up = false;
      const sort = () => {
        up = !up;
        const value = (row) => row.cells[column].textContent;
        const order = (one, other) =>
          value(one).localeCompare(value(other), "en", { numeric: true }) * (up ? 1 : -1);
        const numbers = (one, other) => (Number(value(one)) - Number(value(other))) * (up ? 1 : -1);
        const numeric = rows.every((row) => value(row) === "" || !Number.isNaN(Number(value(row))));
        table.tBodies[0].append(...rows.sort(numeric ? numbers : order));
      };
      cell.addEventListener("click", sort);
      cell.addEventListener("keydown", (event) => event.key === "Enter" && sort());
    });
  }
});
