/** Small hands for the document. Everything that is shown goes in as text: names and words of vendors are not trusted. */

/** Make an element: attributes as they are, `text`, `on` for listeners; children are nodes or strings. */
export function el(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name === "text") made.textContent = value;
    else if (name === "on") for (const [event, handler] of Object.entries(value)) made.addEventListener(event, handler);
    else if (value === true) made.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) made.setAttribute(name, value);
  }
  made.append(...children);
  return made;
}

/** Write text only where it changes: a page of eight robots is quiet where nothing happens. */
export function write(node, text) {
  if (node.shown !== text) {
    node.shown = text;
    node.textContent = text;
  }
}

/** Set an attribute only where it changes; null takes it away. */
export function mark(node, name, value) {
  if (value === null) {
    if (node.hasAttribute(name)) node.removeAttribute(name);
  } else if (node.getAttribute(name) !== value) node.setAttribute(name, value);
}

/** Set a style only where it changes. */
export function shape(node, transform) {
  if (node.shaped !== transform) {
    node.shaped = transform;
    node.style.transform = transform;
  }
}

/** Fill a select, and keep what is chosen if it is still there. */
export function fill(select, options, chosen = select.value) {
  select.replaceChildren(...options.map(([value, text]) => el("option", { value, text })));
  if (options.some(([value]) => value === chosen)) select.value = chosen;
}

/** Calls painters once before the next frame, however often they ask. */
class Painter {
  constructor() {
    this._due = new Set();
    this._asked = false;
  }

  soon(paint) {
    this._due.add(paint);
    if (this._asked) return;
    this._asked = true;
    requestAnimationFrame((now) => {
      this._asked = false;
      const due = [...this._due];
      this._due.clear();
      for (const one of due) one(now);
    });
  }
}

export const painter = new Painter();
