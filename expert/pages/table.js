"use strict";
function value(cell) {
  var text = cell.textContent.trim();
  return /^[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?( %)?$/i.test(text) ? parseFloat(text) : text;
}
document.querySelectorAll("table.sortable").forEach(function (table) {
  var body = table.tBodies[0];
  table.querySelectorAll("thead th").forEach(function (head, column) {
    var button = document.createElement("button");
    button.type = "button";
    button.textContent = head.textContent;
    head.textContent = "";
    head.appendChild(button);
    button.addEventListener("click", function () {
      var down = head.getAttribute("aria-sort") === "ascending";
      table.querySelectorAll("thead th").forEach(function (other) { other.removeAttribute("aria-sort"); });
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      var rows = Array.prototype.slice.call(body.rows);
      rows.sort(function (a, b) {
        var one = value(a.cells[column]), two = value(b.cells[column]);
        if (one === "" || two === "") return one === two ? 0 : one === "" ? 1 : -1;  // what is empty stays last
        var order = typeof one === "number" && typeof two === "number" ? one - two : String(one).localeCompare(String(two), undefined, {numeric: true});
        return down ? -order : order;
      });
      rows.forEach(function (row) { body.appendChild(row); });
    });
  });
});
