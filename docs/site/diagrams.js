// Draws the diagrams of a page by Mermaid, which lies beside the pages (docs/site/hooks.py puts it there).
// Where a page is opened from a disk, browsers load no modules: the diagram then stays its own text.
const diagrams = document.querySelectorAll("pre.diagram");
if (diagrams.length > 0) {
  const { mermaid } = await import("./mermaid/index.js");
  const dark = document.body.dataset.mdColorScheme === "slate";
  mermaid.initialize({ startOnLoad: false, theme: dark ? "dark" : "neutral" });
  for (const [index, element] of diagrams.entries()) {
    const { svg } = await mermaid.render(`diagram-${index}`, element.textContent);
    const drawn = document.createElement("div");
    drawn.className = "diagram";
    drawn.innerHTML = svg;
    element.replaceWith(drawn);
  }
}
