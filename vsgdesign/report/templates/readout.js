// A read-out under the pointer for maps and loci. The page says everything without it.
(function () {
  "use strict";
  var data = JSON.parse(document.getElementById("hover-data").textContent);
  var box = document.getElementById("readout");
  function entry(group) {
    // Panels that share their cells (gains) carry a name of their own after the key.
    var key = group.id.split("-hover.")[1];
    return data[key] || data[key.replace(/\.[^.]+$/, "")];
  }
  function between(edges, value) {
    for (var k = 0; k + 1 < edges.length; k++) if (value >= edges[k] && value <= edges[k + 1]) return k;
    return -1;
  }
  function along(edges, share, log) {
    var a = edges[0], b = edges[edges.length - 1];
    return log ? a * Math.pow(b / a, share) : a + (b - a) * share;
  }
  function named(name, value, log) {
    return log ? name + " " + value : name + " " + (100 * value).toFixed(0) + " %";
  }
  function cell(map, u, v) {
    var i = between(map.edges[0], along(map.edges[0], u, map.log));
    var j = between(map.edges[1], along(map.edges[1], v, map.log));
    if (i < 0 || j < 0) return "";
    var first = (i * map.values[1].length + j) * map.per;
    var place = named(map.names[0], map.values[0][i], map.log) + ", " + named(map.names[1], map.values[1][j], map.log);
    return place + "\n" + map.texts.slice(first, first + map.per).join("\n");
  }
  function mode(view, u, v, width, height) {
    var locus = data[view.of], l = view.limits, best = null, least = 144;
    locus.points.forEach(function (p) {
      var x = ((p[1] - l[0]) / (l[1] - l[0]) - u) * width, y = ((p[2] - l[2]) / (l[3] - l[2]) - v) * height;
      if (x * x + y * y < least) { least = x * x + y * y; best = p; }
    });
    if (!best) return "";
    var size = Math.hypot(best[1], best[2]);
    return locus.name + " " + best[0] + "\ns = " + best[1] + (best[2] > 1e-6 ? " ± " + best[2] + "j" : "") + " 1/s\nζ = " +
      (size > 0 ? (-best[1] / size).toPrecision(3) : "1") + ", " + (best[2] / 2 / Math.PI).toPrecision(3) + " Hz";
  }
  document.querySelectorAll("figure.drawing svg").forEach(function (svg) {
    var panels = Array.prototype.filter.call(svg.querySelectorAll("[id*='-hover.']"), function (group) {
      return entry(group);
    });
    if (!panels.length) return;
    svg.addEventListener("mousemove", function (event) {
      var text = "";
      panels.forEach(function (group) {
        var r = group.getBoundingClientRect();
        var u = (event.clientX - r.left) / r.width, v = (r.bottom - event.clientY) / r.height;
        if (u < 0 || u > 1 || v < 0 || v > 1) return;
        var found = entry(group);
        text = found.of ? mode(found, u, v, r.width, r.height) : cell(found, u, v);
      });
      box.textContent = text;
      box.hidden = !text;
      box.style.left = Math.max(4, Math.min(event.clientX + 14, window.innerWidth - box.offsetWidth - 8)) + "px";
      box.style.top = Math.max(4, Math.min(event.clientY + 14, window.innerHeight - box.offsetHeight - 8)) + "px";
    });
    svg.addEventListener("mouseleave", function () { box.hidden = true; });
  });
})();
