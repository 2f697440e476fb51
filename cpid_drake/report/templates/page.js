(() => {
  // A link to a folded section opens it.
  const open = () => {
    const target = document.getElementById(location.hash.slice(1));
    if (target instanceof HTMLDetailsElement) target.open = true;
  };
  addEventListener("hashchange", open);
  document.querySelectorAll("nav a").forEach((a) => a.addEventListener("click", () => setTimeout(open)));
  open();

  // Text and grid of a figure have the colours of the page's light or dark mode.
  const template = () => {
    const style = getComputedStyle(document.documentElement);
    const color = (name) => style.getPropertyValue(`--${name}`).trim();
    const axis = { automargin: true, gridcolor: color("line"), linecolor: color("faint"), zerolinecolor: color("line") };
    return { layout: {
      font: { color: color("ink"), family: "system-ui, sans-serif" },
      hoverlabel: { bgcolor: color("card"), font: { color: color("ink") } },
      modebar: { bgcolor: "rgba(0, 0, 0, 0)", color: color("faint"), activecolor: color("ink") },
      paper_bgcolor: "rgba(0, 0, 0, 0)", plot_bgcolor: "rgba(0, 0, 0, 0)", xaxis: axis, yaxis: axis,
    } };
  };
  const contents = (element) => JSON.parse(element.nextElementSibling.textContent);
  const draw = (plot) => {
    const { data, layout } = contents(plot);
    // A finger on a figure scrolls the page.
    const dragmode = matchMedia("(pointer: coarse)").matches ? false : "zoom";
    // Without a mouse the buttons would always be there, and over the axes of small figures.
    const hovers = matchMedia("(hover: hover)").matches;
    const config = { displaylogo: false, responsive: true, ...(hovers ? {} : { displayModeBar: false }) };
    Plotly.react(plot, data, { ...layout, dragmode, template: template() }, config);
  };
  const play = (scene) => {
    const frame = document.createElement("iframe");
    frame.title = "Scene";
    frame.srcdoc = contents(scene);
    scene.append(frame);
    // Until it is clicked, the wheel over the scene scrolls the page.
    scene.addEventListener("click", () => scene.classList.add("active"));
    scene.addEventListener("mouseleave", () => scene.classList.remove("active"));
  };

  // What is not seen yet, such as a figure in a folded section, is not drawn.
  const drawn = [];
  const watcher = new IntersectionObserver((entries) => entries.forEach(({ isIntersecting, target }) => {
    if (!isIntersecting) return;
    watcher.unobserve(target);
    if (target.className === "scene") return setTimeout(play, 0, target);
    drawn.push(target);
    draw(target);
  }), { rootMargin: "200px" });
  document.querySelectorAll(".plot, .scene").forEach((each) => watcher.observe(each));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => drawn.forEach(draw));
})();
