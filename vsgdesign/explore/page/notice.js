// Words to the user: at the top of the page, and for a screen reader alone.

/** Words at the top of the page; without words they go away. */
export function notice(text, bad = false) {
  const place = document.getElementById("notice");
  place.hidden = !text;
  place.textContent = text;
  place.classList.toggle("bad", bad);
}

/** Words for a screen reader. */
export function say(text) {
  document.getElementById("said").textContent = text;
}
