// Draws each scene of the page: points, lines and labels in millimetres, seen in gentle perspective.
for (const canvas of document.querySelectorAll("canvas.scene")) {
  const scene = JSON.parse(canvas.dataset.scene);
  const all = scene.points.concat(...scene.lines.map(line => line[1]));
  const low = [0, 1, 2].map(i => all.reduce((m, p) => Math.min(m, p[i]), Infinity));
  const high = [0, 1, 2].map(i => all.reduce((m, p) => Math.max(m, p[i]), -Infinity));
  const middle = low.map((l, i) => (l + high[i]) / 2);
  const reach = Math.hypot(...low.map((l, i) => high[i] - l)) / 2;
  let turn = 0.6, tilt = 1.05, zoom = 0;

  // The largest zoom at which everything is in the picture as it is first shown.
  const fit = (width, height) => {
    const [ct, st, cp, sp] = [Math.cos(turn), Math.sin(turn), Math.cos(tilt), Math.sin(tilt)];
    let wide = 1e-9, high = 1e-9;
    for (const p of all) {
      const [x, y, z] = p.map((v, i) => v - middle[i]);
      wide = Math.max(wide, Math.abs(x * ct + y * st));
      high = Math.max(high, Math.abs(z * sp + (-x * st + y * ct) * cp));
    }
    return 0.86 * Math.min(width / wide, height / high) * reach / Math.min(width, height);
  };

  const draw = () => {
    const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
    canvas.width = width * ratio; canvas.height = height * ratio;
    const g = canvas.getContext("2d");
    // the palette's colours are the page's variables, which follow its colour scheme
    const style = getComputedStyle(canvas);
    const ink = color => color.startsWith("var(") ? style.getPropertyValue(color.slice(4, -1)).trim() : color;
    g.scale(ratio, ratio);
    if (!zoom) zoom = fit(width, height);
    const scale = zoom * Math.min(width, height) / 2 / reach;
    const [ct, st, cp, sp] = [Math.cos(turn), Math.sin(turn), Math.cos(tilt), Math.sin(tilt)];
    // camera axes (y down, z forward) are drawn with the scene's z downwards: the belt lies below the cameras
    const place = p => {
      const [x, y, z] = p.map((v, i) => v - middle[i]);
      const a = x * ct + y * st, b = -x * st + y * ct;
      const depth = b * sp - z * cp, w = 1 / (1 + depth / (6 * reach));
      return [width / 2 + a * scale * w, height / 2 + (z * sp + b * cp) * scale * w, depth];
    };
    const dots = scene.points.map((p, i) => [...place(p), scene.colors[i]]).sort((m, n) => n[2] - m[2]);
    for (const [x, y, , color] of dots) {
      g.fillStyle = `rgb(${color})`;
      g.fillRect(x - 1, y - 1, 2.2, 2.2);
    }
    g.lineWidth = 1.4;
    for (const [color, line] of scene.lines) {
      g.strokeStyle = ink(color);
      g.beginPath();
      line.map(place).forEach(([x, y], i) => i ? g.lineTo(x, y) : g.moveTo(x, y));
      g.stroke();
    }
    g.fillStyle = ink("var(--c-ink)");
    g.font = "600 13px system-ui, sans-serif";
    for (const [text, where] of scene.labels) {
      const [x, y] = place(where);
      g.fillText(text, x + 6, y - 6);
    }
  };
  canvas.addEventListener("pointermove", event => {
    if (!event.buttons) return;
    turn -= event.movementX * 0.008;
    tilt = Math.max(0, Math.min(Math.PI / 2, tilt - event.movementY * 0.008));
    draw();
  });
  canvas.addEventListener("wheel", event => {
    event.preventDefault();
    zoom *= Math.exp(-event.deltaY * 0.001);
    draw();
  }, { passive: false });
  window.addEventListener("resize", draw);
  for (const query of ["print", "(prefers-color-scheme: dark)"]) matchMedia(query).addEventListener("change", draw);
  draw();
}
