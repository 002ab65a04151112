"use strict";
document.querySelectorAll(".wipe").forEach(function (figure) {
  var slider = figure.querySelector("input[type=range]");
  var stack = figure.querySelector(".stack");
  function show() {
    stack.style.setProperty("--at", slider.value + "%");
    slider.setAttribute("aria-valuetext", slider.value + " percent of the picture show the corrected image");
  }
  slider.addEventListener("input", show);
  figure.querySelector("button").addEventListener("click", function () {
    slider.value = Number(slider.value) > 50 ? 0 : 100;
    show();
  });
  show();
});
var only = document.getElementById("only-mattered");
if (only) {
  only.addEventListener("change", function () {
    document.querySelectorAll("#facts tbody tr").forEach(function (row) {
      row.hidden = only.checked && !row.classList.contains("mattered");
    });
  });
}
window.addEventListener("beforeprint", function () {
  document.querySelectorAll("details:not(.record)").forEach(function (item) { item.open = true; });
});
