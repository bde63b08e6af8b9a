"use strict";
// What the player adds to Bokeh's drawing and to the browser's own slider: which moment is shown.
(async () => {
  const part = (name) => document.getElementById(`player-${name}`);
  const { document: plots, roots, frames, themed } = JSON.parse(part("data").textContent);
  const packed = new Int16Array(Uint8Array.from(atob(frames.values), (char) => char.charCodeAt(0)).buffer);
  const width = packed.length / frames.time.length;
  const slider = part("time"), button = part("play"), speed = part("speed");

  part("without").hidden = true;
  part("body").hidden = false;

  let views, now, sources = [];
  const drawn = async () => { // a canvas knows no style: the page's colours of the moment are put in, light or dark
    const own = getComputedStyle(part("body"));
    const ours = Object.entries(themed).map(([colour, name]) => [colour, own.getPropertyValue(name).trim()]);
    const told = ours.reduce((text, [colour, shown]) => text.replaceAll(colour, shown), JSON.stringify(plots));
    views?.clear();
    [views] = await Bokeh.embed.embed_items({ player: JSON.parse(told) }, [{ docid: "player", roots, root_ids: Object.keys(roots) }]);
    const model = Bokeh.documents.at(-1);
    if (!model.is_idle) await new Promise((done) => model.idle.connect(done)); // its first strokes are for no size yet
    now = model.get_model_by_name("now");
    sources = frames.parts.map((one) => model.get_model_by_name(one.source));
    for (const plot of model.get_model_by_name("curves")?.children ?? []) {
      plot.on_event("tap", ({ x }) => { set(false); show(nearest(x)); });
    }
  };

  const number = (whole) => (whole === frames.unknown ? NaN : whole * frames.step);
  const show = (moment) => {
    let start = moment * width;
    frames.parts.forEach(({ columns, rows }, k) => {
      const data = { ...sources[k].data };
      for (const column of columns) {
        data[column] = Array.from(packed.subarray(start, start + rows), number);
        start += rows;
      }
      sources[k].data = data;
    });
    const time = frames.time[moment];
    if (now) now.location = time;
    part("now").value = `${time.toFixed(2)} s`;
    slider.value = moment;
    slider.setAttribute("aria-valuetext", `${time.toFixed(2)} seconds`);
  };

  const nearest = (time) => {
    const after = frames.time.findIndex((one) => one >= time);
    if (after < 0) return frames.time.length - 1;
    return after > 0 && time - frames.time[after - 1] < frames.time[after] - time ? after - 1 : after;
  };

  let playing = false, clock = 0, before = 0;
  const set = (wanted) => {
    playing = wanted;
    button.textContent = playing ? "Pause" : "Play";
    if (!playing) return;
    const last = frames.time.length - 1;
    clock = frames.time[Number(slider.value) === last ? 0 : Number(slider.value)];
    before = performance.now();
    requestAnimationFrame(tick);
  };
  const tick = (stamp) => {
    if (!playing) return;
    clock += (Number(speed.value) * Math.max(stamp - before, 0)) / 1000;
    before = stamp;
    const moment = nearest(clock);
    if (moment !== Number(slider.value)) show(moment);
    if (clock >= frames.time[frames.time.length - 1]) set(false);
    else requestAnimationFrame(tick);
  };

  button.addEventListener("click", () => set(!playing));
  slider.addEventListener("input", () => { set(false); show(Number(slider.value)); });
  slider.addEventListener("keydown", (event) => {
    if (event.key === " ") { event.preventDefault(); set(!playing); }
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", async () => {
    await drawn();
    show(Number(slider.value));
  });
  await drawn();
  show(0);
  part("body").dataset.ready = "yes";
})();
