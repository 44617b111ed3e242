// The page's drawing in slices: each is a task of its own, so that moves and keys are heard between them.

const waiting = new Map();
const { port1, port2 } = new MessageChannel();

function first() {
  const [name, act] = waiting.entries().next().value;
  waiting.delete(name);
  act();
}

port1.onmessage = () => {
  if (waiting.size > 1) port2.postMessage(0);
  if (waiting.size) first();
};

/** Does something soon, after all that waits already; a slice of the same name that waits is replaced. */
export function soon(name, act) {
  if (!waiting.size) port2.postMessage(0);
  waiting.set(name, act);
}

/** Does all that waits. */
export function atOnce() {
  while (waiting.size) first();
}
