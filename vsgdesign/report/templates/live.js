// Opens a page that is kept packed in this one, in a frame of its own, as soon as it is near the reader.
(() => {
  const part = document.currentScript.closest(".live");
  const note = part.querySelector("[role=status]");
  const say = (words) => {
    note.textContent = words;
    note.hidden = !words;
  };
  // The shortest module that there is: whether WebAssembly is missing or forbidden.
  const compiles = () => {
    try {
      return Boolean(new WebAssembly.Module(Uint8Array.of(0, 97, 115, 109, 1, 0, 0, 0)));
    } catch {
      return false;
    }
  };
  // On a narrow screen the frame is as high as what it shows: two pages that scroll in each other are hard to use.
  const fit = (frame) => {
    const { body } = frame.contentDocument;
    const narrow = frame.contentWindow.matchMedia("(max-width: 1000px)").matches;
    const height = narrow ? `${Math.ceil(body.getBoundingClientRect().height) + 2}px` : "";
    if (frame.style.height !== height) frame.style.height = height;
  };
  // A link of the report chooses a case: its number is in the address. The page in the frame needs a moment to be there.
  const choose = (frame) => {
    const [, number] = /^#try-it-(\d+)$/.exec(window.location.hash) || [];
    if (!number || !frame) return;
    if (!frame.contentWindow.page) {
      setTimeout(choose, 50, frame);
      return;
    }
    const chosen = frame.contentDocument.getElementById("case");
    chosen.value = String(number - 1);
    chosen.dispatchEvent(new Event("change"));
  };
  window.addEventListener("click", ({ target }) => {
    // The address is that of the link once the click is done; a link that was followed before leads there again.
    if (target.closest('a[href^="#try-it-"]')) setTimeout(() => choose(part.querySelector("iframe")));
  });
  const open = async () => {
    say(part.dataset.opening);
    try {
      const packed = Uint8Array.from(atob(part.querySelector("template").innerHTML), (c) => c.charCodeAt(0));
      const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
      const frame = document.createElement("iframe");
      frame.title = part.dataset.title;
      frame.srcdoc = await new Response(stream).text();
      frame.addEventListener("load", () => {
        say("");
        choose(frame);
        new ResizeObserver(() => fit(frame)).observe(frame.contentDocument.body);
        window.addEventListener("resize", () => fit(frame));
      });
      part.querySelector("div").append(frame);
    } catch (error) {
      say(`${part.dataset.without} (${error.message})`);
    }
  };
  if (!compiles()) {
    say(part.dataset.without);
    return;
  }
  new IntersectionObserver(
    (entries, observer) => {
      if (!entries.some((entry) => entry.isIntersecting)) return;
      observer.disconnect();
      open();
    },
    { rootMargin: "400px" },
  ).observe(part);
})();
