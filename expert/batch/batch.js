(function () {
  var words = document.getElementById("words"), status = document.getElementById("status"), rule = "";
  var shown = document.getElementById("shown"), rows = document.getElementById("pairs").tBodies[0].rows;
  var buttons = document.querySelectorAll("#rules button[data-rule]");
  function filter() {
    var count = 0, wanted = words.value.toLowerCase();
    Array.prototype.forEach.call(rows, function (row) {
      var rules = " " + row.dataset.rules + " ";
      var fits = (row.textContent + rules).toLowerCase().indexOf(wanted) >= 0 && (!status.value || row.dataset.status === status.value) &&
        (!rule || rules.indexOf(" " + rule + " ") >= 0);
      row.hidden = !fits;
      count += fits ? 1 : 0;
    });
    shown.textContent = count + " of " + rows.length + " pairs" + (rule ? ", those for which " + rule + " fired" : "");
    buttons.forEach(function (button) { button.setAttribute("aria-pressed", String(button.dataset.rule === rule)); });
  }
  words.addEventListener("input", filter);
  status.addEventListener("change", filter);
  buttons.forEach(function (button) {
    button.addEventListener("click", function () { rule = rule === button.dataset.rule ? "" : button.dataset.rule; filter(); });
  });
  document.getElementById("all").addEventListener("click", function () { words.value = status.value = rule = ""; filter(); });
  filter();
}());
