(function () {
  var words = document.getElementById("words"), status = document.getElementById("status");
  var shown = document.getElementById("shown"), rows = document.getElementById("pairs").tBodies[0].rows;
  function filter() {
    var count = 0, wanted = words.value.toLowerCase();
    Array.prototype.forEach.call(rows, function (row) {
      var fits = row.textContent.toLowerCase().indexOf(wanted) >= 0 && (!status.value || row.dataset.status === status.value);
      row.hidden = !fits;
      count += fits ? 1 : 0;
    });
    shown.textContent = count + " of " + rows.length + " pairs";
  }
  words.addEventListener("input", filter);
  status.addEventListener("change", filter);
  filter();
}());
