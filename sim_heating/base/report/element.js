"use strict";
// One HTML element with its attributes and its text, which is only ever set as text, at the end of a parent.
const element = (tag, parent, { text, ...rest } = {}) => {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(rest)) made.setAttribute(name, value);
  if (text !== undefined) made.textContent = text;
  if (parent) parent.appendChild(made);
  return made;
};
