// The belt from above for browsers without WebGL: an image of heights, the newest row at the right.
import { find_slot, RING, UNKNOWN } from "./belt_rows.js";
import { viridis } from "./viridis.js";

export class FlatBelt {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
  }

  draw(rows, { window_m, high_mm, dark }) {
    const wide = Math.min(Math.round(window_m * 1000 / rows.cell_mm), RING);
    this.canvas.width = wide;
    this.canvas.height = rows.columns;
    const picture = this.context.createImageData(wide, rows.columns);
    for (let i = 0; i < wide; i++) {
      const row = rows.end - wide + i;
      for (let column = 0; column < rows.columns; column++) {
        const count = row >= rows.begin ? rows.counts[find_slot(row) * rows.columns + column] : UNKNOWN;
        picture.data.set(this.get_cell_colour(count, rows, high_mm, dark, i + column), (column * wide + i) * 4);
      }
    }
    this.context.putImageData(picture, 0, 0);
  }

  get_cell_colour(count, rows, high_mm, dark, diagonal) {
    if (count === UNKNOWN) return [0, 0, 0, 0];
    if (count & 0x8000 && diagonal % 8 < 3) return dark ? [120, 132, 142, 255] : [150, 160, 168, 255];
    return [...viridis(((count & 0x7fff) * rows.step_mm + rows.offset_mm) / high_mm), 255];
  }
}
