(() => {
  "use strict";
  const form = document.getElementById("filter");
  const tests = [...document.querySelectorAll(".matrix > tbody")].map((body) => ({
    body,
    words: body.textContent.replace(/−/g, "-").toLowerCase(),
    group: body.closest("details"),
  }));
  const groups = [...new Set(tests.map((test) => test.group))];
  const opened = new Map(groups.map((group) => [group, group.open]));
  // "SCR 2" is not a part of "SCR 20" or of "SCR 2.5".
  const patternOf = (phrase) => {
    const text = phrase.replace(/−/g, "-").toLowerCase().trim();
    const escaped = text.replace(/[.*+?^${}()|[\]\\]/g, "\\$&");
    return new RegExp(escaped + (/\d$/.test(text) ? "(?!\\.?\\d)" : ""));
  };
  const show = () => {
    const verdict = form.elements.show.value;
    const words = form.elements.words.value.split(",").filter((phrase) => phrase.trim()).map(patternOf);
    const filled = new Set();
    let shown = 0;
    for (const test of tests) {
      const match =
        (!verdict || test.body.classList.contains(`has-${verdict}`)) && words.every((word) => word.test(test.words));
      test.body.hidden = !match;
      if (match) {
        filled.add(test.group);
        shown += 1;
      }
    }
    const any = verdict || words.length > 0;
    for (const group of groups) {
      group.hidden = !filled.has(group);
      group.open = any ? shown <= 60 || opened.get(group) : opened.get(group);
    }
    form.querySelector("output").textContent = any ? `${shown} of ${tests.length} tests` : "";
  };
  const jump = () => {
    const target = location.hash.length > 1 && document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (!target) return;
    const group = target.closest("details");
    if (target.hidden) {
      form.reset();
      show();
    }
    if (group) group.open = true;
    target.scrollIntoView();
  };
  form.hidden = false;
  form.addEventListener("input", show);
  form.addEventListener("submit", (event) => event.preventDefault());
  window.addEventListener("hashchange", jump);
  jump();
  for (const code of document.querySelectorAll(".command code")) {
    const button = document.createElement("button");
    button.type = "button";
    button.className = "copy";
    button.textContent = "Copy";
    button.addEventListener("click", async () => {
      const text = code.textContent;
      try {
        await navigator.clipboard.writeText(text);
        button.textContent = "Copied";
      } catch {
        getSelection().selectAllChildren(code);
        button.textContent = "Selected: press Ctrl-C";
      }
    });
    code.after(button);
  }
})();
