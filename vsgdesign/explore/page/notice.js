// Words to the user: at the top of the page, and for a screen reader alone.

/** Words over the top of the page; without words they go away. They never move what is drawn. */
export function notice(text, bad = false) {
  const place = document.getElementById("notice");
  place.hidden = !text;
  place.textContent = text;
  place.classList.toggle("bad", bad);
}

/** Good news goes away with the next change; bad news stays until it is no longer true. */
export function forgetGoodNews() {
  const place = document.getElementById("notice");
  if (!place.classList.contains("bad")) notice("");
}

/** Words for a screen reader. */
export function say(text) {
  document.getElementById("said").textContent = text;
}
