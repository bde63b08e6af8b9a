"use strict";
// Player: shows the frame selected by the slider, in addition to the page's charts.
(async () => {
  const part = (name) => document.getElementById(`player-${name}`);
  const { figure, curves, ...frames } = JSON.parse(part("data").textContent);
  const packed = new Int16Array(Uint8Array.from(atob(frames.values), (char) => char.charCodeAt(0)).buffer);
  const width = packed.length / frames.time.length;
  const slider = part("time"), button = part("play"), speed = part("speed");

  part("without").hidden = true;
  part("body").hidden = false;
  const [moving] = await Charts.draw(part("figure"), figure);
  const timed = curves ? await Charts.draw(part("curves"), curves) : [];
  const shapes = timed.map((plot) => plot.layout.shapes ?? []);

  const number = (whole) => (whole === frames.unknown ? null : whole * frames.step);
  const turn = part("turn"), tilt = part("tilt"), dimensions = frames.centre ? 3 : 2;
  const projected = (own, along) => own[0].map((x, k) => (x === null ? null
    : along[0] * (x - frames.centre[0]) + along[1] * (own[1][k] - frames.centre[1]) + along[2] * (own[2][k] - frames.centre[2])));
  const show = (moment) => {
    const x = [], y = [], seen = frames.centre ? Charts.view(Number(turn.value), Number(tilt.value)) : null;
    let start = moment * width;
    for (const rows of frames.rows) {
      const own = Array.from({ length: dimensions }, (_, k) => Array.from(packed.subarray(start + k * rows, start + (k + 1) * rows), number));
      x.push(seen ? projected(own, seen[0]) : own[0]);
      y.push(seen ? projected(own, seen[1]) : own[1]);
      start += dimensions * rows;
    }
    const time = frames.time[moment];
    part("now").value = `${time.toFixed(2)} s`;
    slider.value = moment;
    slider.setAttribute("aria-valuetext", `${time.toFixed(2)} seconds`);
    const line = { type: "line", x0: time, x1: time, y0: 0, y1: 1, yref: "paper", line: { color: "#882255", width: 2 } };
    timed.forEach((plot, k) => Plotly.relayout(plot, { shapes: [...shapes[k], line] }));
    return Plotly.restyle(moving, { x, y });
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
  const tick = async (stamp) => {
    if (!playing) return;
    clock += (Number(speed.value) * Math.max(stamp - before, 0)) / 1000;
    before = stamp;
    const moment = nearest(clock);
    if (moment !== Number(slider.value)) await show(moment);
    if (clock >= frames.time[frames.time.length - 1]) set(false);
    else requestAnimationFrame(tick);
  };

  button.addEventListener("click", () => set(!playing));
  slider.addEventListener("input", () => { set(false); show(Number(slider.value)); });
  slider.addEventListener("keydown", (event) => {
    if (event.key === " ") { event.preventDefault(); set(!playing); }
  });
  if (frames.centre) { // dragging the figure turns it, as the sliders do
    const again = () => show(Number(slider.value));
    turn.addEventListener("input", again);
    tilt.addEventListener("input", again);
    Plotly.relayout(moving, { dragmode: false });
    moving.style.touchAction = "pan-y";
    moving.addEventListener("pointermove", (event) => {
      if (!(event.buttons & 1)) return;
      turn.value = ((((Number(turn.value) - event.movementX / 2 + 180) % 360) + 360) % 360) - 180;
      tilt.value = Number(tilt.value) + event.movementY / 2;
      again();
    });
  }
  for (const plot of timed) {
    plot.addEventListener("click", (event) => {
      const { xaxis } = plot._fullLayout;
      const time = xaxis.p2d(event.clientX - plot.getBoundingClientRect().left - xaxis._offset);
      set(false);
      show(nearest(time));
    });
  }
  await show(0);
  part("body").dataset.ready = "yes";
})();
