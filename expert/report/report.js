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

(function () {
  var only = document.getElementById("only-mattered"), words = document.getElementById("fact-words");
  var rows = document.querySelectorAll("#facts tbody tr");
  function filter() {
    var wanted = words.value.toLowerCase(), count = 0;
    rows.forEach(function (row) {
      row.hidden = (only.checked && !row.classList.contains("mattered")) || row.textContent.toLowerCase().indexOf(wanted) < 0;
      count += row.hidden ? 0 : 1;
    });
    document.getElementById("facts-shown").textContent = count + " of " + rows.length;
  }
  only.checked = matchMedia("(max-width: 40rem)").matches;
  only.addEventListener("change", filter);
  words.addEventListener("input", filter);
  filter();
}());

(function () {
  var button = document.getElementById("open-3d");
  if (!button) return;
  button.addEventListener("click", function () {
    var frame = document.createElement("iframe");
    frame.title = "Terrain in three dimensions";
    frame.setAttribute("sandbox", "allow-scripts");
    frame.srcdoc = JSON.parse(document.getElementById("page-3d").textContent);
    document.getElementById("view-3d").replaceChildren(frame);
  });
}());

(function () {
  var svg = document.getElementById("decision-graph");
  if (!svg) return;
  var box = document.getElementById("graph-box"), about = document.getElementById("graph-about");
  var compact = document.getElementById("graph-compact");
  var size = [svg.getAttribute("width"), svg.getAttribute("height")];
  var nodes = Array.prototype.map.call(svg.querySelectorAll(".node"), function (element) {
    var rect = element.querySelector("rect"), at = /translate\(([-\d.]+),([-\d.]+)\)/.exec(element.getAttribute("transform"));
    return {
      element: element, column: Number(element.dataset.column), x: Number(at[1]), y: Number(at[2]), before: [], after: [],
      width: Number(rect.getAttribute("width")), height: Number(rect.getAttribute("height"))
    };
  });
  var edges = Array.prototype.map.call(svg.querySelectorAll(".edge"), function (element) {
    var edge = {
      element: element, from: nodes[element.dataset.from], to: nodes[element.dataset.to], path: element.getAttribute("d"),
      label: element.querySelector("title").textContent
    };
    edge.from.after.push(edge);
    edge.to.before.push(edge);
    return edge;
  });
  var none = about.firstElementChild, chosen = null;

  function reach(node, side, end) {
    var found = new Set([node]), todo = [node];
    while (todo.length) todo.pop()[side].forEach(function (edge) {
      if (!found.has(edge[end])) { found.add(edge[end]); todo.push(edge[end]); }
    });
    return found;
  }
  function put(node, x, y) {
    node.left = x; node.top = y;
    node.element.setAttribute("transform", "translate(" + x + "," + y + ")");
  }
  function resize(width, height) {
    svg.setAttribute("width", width); svg.setAttribute("height", height);
    svg.setAttribute("viewBox", "0 0 " + width + " " + height);
  }
  function asDrawn() {
    nodes.forEach(function (node) { put(node, node.x, node.y); });
    edges.forEach(function (edge) { edge.element.setAttribute("d", edge.path); });
    resize(size[0], size[1]);
  }
  // Stack what is left in the columns that are left, in the order it had, each column about the same middle.
  function stack(near) {
    var columns = [], x = 16, tallest = 0;
    near.forEach(function (node) { (columns[node.column] = columns[node.column] || []).push(node); });
    columns = columns.filter(Boolean);
    var heights = columns.map(function (column) {
      column.sort(function (a, b) { return a.y - b.y; });
      return column.reduce(function (sum, node) { return sum + node.height + 12; }, -12);
    });
    tallest = Math.max.apply(null, heights);
    columns.forEach(function (column, index) {
      var y = 16 + (tallest - heights[index]) / 2, wide = 0;
      column.forEach(function (node) { put(node, x, y); y += node.height + 12; wide = Math.max(wide, node.width); });
      x += wide + 56;
    });
    edges.forEach(function (edge) {
      if (!near.has(edge.from) || !near.has(edge.to)) return;
      var ahead = edge.from.left < edge.to.left, x0 = edge.from.left + (ahead ? edge.from.width : 0), y0 = edge.from.top + edge.from.height / 2;
      var x1 = edge.to.left + (ahead ? -2 : edge.to.width + 2), y1 = edge.to.top + edge.to.height / 2, middle = (x0 + x1) / 2;
      edge.element.setAttribute("d", "M" + x0 + "," + y0 + "C" + middle + "," + y0 + " " + middle + "," + y1 + " " + x1 + "," + y1);
    });
    resize(x - 40, tallest + 32);
  }
  function list(title, found, end) {
    if (!found.length) return;
    var head = document.createElement("h4"), items = document.createElement("ul");
    head.textContent = title;
    found.forEach(function (edge) {
      var item = document.createElement("li");
      item.textContent = edge[end].element.getAttribute("aria-label") + " (" + edge.label + ")";
      items.appendChild(item);
    });
    about.append(head, items);
  }
  function tell(node) {
    var head = document.createElement("h3"), table = null;
    head.textContent = node.element.getAttribute("aria-label");
    about.replaceChildren(head);
    var wanted = node.element.dataset.about;
    if (wanted) document.querySelectorAll('[data-id="' + wanted + '"]').forEach(function (source) {
      if (source.tagName === "TR") {
        if (!table) { table = document.createElement("table"); about.appendChild(table); }
        var row = source.cloneNode(true);
        row.hidden = false;
        table.appendChild(row);
        return;
      }
      Array.prototype.forEach.call(source.childNodes, function (child) {
        if (child.tagName !== "SUMMARY") about.appendChild(child.cloneNode(true));
      });
    });
    about.querySelectorAll("[data-id]").forEach(function (copy) { copy.removeAttribute("data-id"); });
    about.querySelectorAll("details").forEach(function (copy) { copy.open = true; });
    list("From", node.before, "from");
    list("To", node.after, "to");
  }
  function focus(node) {
    nodes.forEach(function (other) { other.element.tabIndex = other === node ? 0 : -1; });
    node.element.focus({preventScroll: true});
    node.element.scrollIntoView({block: "nearest", inline: "center"});
  }
  function choose(node) {
    chosen = node;
    var near = node ? reach(node, "before", "from") : new Set();
    if (node) reach(node, "after", "to").forEach(function (other) { near.add(other); });
    nodes.forEach(function (other) {
      other.element.classList.toggle("near", near.has(other));
      other.element.classList.toggle("chosen", other === node);
      if (other === node) other.element.setAttribute("aria-pressed", "true"); else other.element.removeAttribute("aria-pressed");
    });
    edges.forEach(function (edge) { edge.element.classList.toggle("near", near.has(edge.from) && near.has(edge.to)); });
    svg.classList.toggle("filtered", Boolean(node));
    svg.classList.toggle("compact", Boolean(node) && compact.checked);
    if (node && compact.checked) stack(near); else asDrawn();
    if (node) { tell(node); focus(node); } else about.replaceChildren(none);
  }
  function shown(node) { return !svg.classList.contains("compact") || node.element.classList.contains("near"); }
  function beside(node, down) {
    var others = nodes.filter(function (other) { return shown(other) && other.column === node.column; });
    others.sort(function (a, b) { return a.y - b.y; });
    return others[others.indexOf(node) + (down ? 1 : -1)];
  }
  function along(node, side, end) {
    var found = node[side].map(function (edge) { return edge[end]; }).filter(shown);
    return found.sort(function (a, b) { return Math.abs(a.y - node.y) - Math.abs(b.y - node.y); })[0];
  }
  nodes.forEach(function (node) {
    node.left = node.x; node.top = node.y;
    node.element.addEventListener("click", function () { choose(node); });
    node.element.addEventListener("keydown", function (event) {
      var next = null;
      if (event.key === "Enter" || event.key === " ") choose(node);
      else if (event.key === "Escape") { choose(null); focus(node); }
      else if (event.key === "ArrowRight") next = along(node, "after", "to");
      else if (event.key === "ArrowLeft") next = along(node, "before", "from");
      else if (event.key === "ArrowDown") next = beside(node, true);
      else if (event.key === "ArrowUp") next = beside(node, false);
      else return;
      event.preventDefault();
      if (next) focus(next);
    });
  });
  compact.addEventListener("change", function () { choose(chosen); });
  document.getElementById("graph-all").addEventListener("click", function () { choose(null); box.scrollTo(0, 0); });
}());

window.addEventListener("beforeprint", function () {
  document.querySelectorAll("#done details, #rules details, #trials details").forEach(function (item) { item.open = true; });
});
