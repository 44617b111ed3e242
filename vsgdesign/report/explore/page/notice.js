// Words to the user: at the top of the page, and for a screen reader alone.

/** Words over the top of the page; without words they go away. They never move what is drawn. */
export function notice(text, bad = false) {
  const place = document.getElementById("notice");
  place.hidden = !text;
  place.textContent = text;
  place.classList.toggle("bad", bad);
}

/** Words go away with the next change of the state, but not those of a server that is lost. */
export function forgetNotice() {
  if (document.documentElement.dataset.state !== "lost") notice("");
}

/** Words for a screen reader. */
export function say(text) {
  document.getElementById("said").textContent = text;
}
