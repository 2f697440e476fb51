// A box that is wider than the screen says so below it, until its end has been scrolled into view.
for (const box of document.querySelectorAll(".scroll")) {
  const cue = document.createElement("p");
  cue.className = "cue";
  cue.textContent = "scroll sideways for more →";
  cue.setAttribute("aria-hidden", "true");
  cue.hidden = true;
  box.after(cue);
  const update = () => {
    const hidden = box.scrollWidth - box.clientWidth;
    cue.hidden = hidden < 2;
    cue.style.visibility = box.scrollLeft > hidden - 2 ? "hidden" : "";
  };
  box.addEventListener("scroll", update);
  new ResizeObserver(update).observe(box);
}
