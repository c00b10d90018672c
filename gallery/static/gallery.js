"use strict";
// A live model is as high as it says, and light or dark as this page is.
const frames = [...document.querySelectorAll("iframe.live")];
const dark = matchMedia("(prefers-color-scheme: dark)");
const tell = frame => {
  const { theme } = document.body.dataset;
  const scheme = theme === "auto" ? (dark.matches ? "dark" : "light") : theme;
  frame.contentWindow.postMessage({ scheme }, "*");
};
addEventListener("message", ({ source, data }) => {
  const frame = frames.find(frame => frame.contentWindow === source);
  if (!frame || !(data.height > 0)) return;
  frame.style.height = `${data.height}px`;
  tell(frame);
});
new MutationObserver(() => frames.forEach(tell)).observe(document.body, { attributeFilter: ["data-theme"] });
dark.addEventListener("change", () => frames.forEach(tell));
document.documentElement.dataset.ready = "yes";
