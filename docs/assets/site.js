// What scrolls sideways takes the focus, so that arrow keys move it.
addEventListener("load", () => {
  const boxes = ".md-typeset__scrollwrap, .highlight pre, .highlight-ipynb, .jp-OutputArea-output";
  for (const box of document.querySelectorAll(boxes))
    if (box.scrollWidth > box.clientWidth) box.tabIndex = 0;
});
