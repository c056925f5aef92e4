// The belt's rows in a ring buffer: row n is stored at n modulo the buffer's length; n is negative where the belt's position is.
export const UNKNOWN = 0xffff;
export const RING = 4096; // a power of two, so that find_slot is right for negative rows

/** Return the place of a row in the ring, 0 to RING - 1. */
export const find_slot = (row) => row & (RING - 1);

export class BeltRows {
  constructor() {
    this.epoch = null;
    this.changes = 0;
  }

  clear() { this.epoch = null; this.changes++; }

  /** Add the rows of a message of the live stream. */
  add(message) {
    if (message.epoch !== this.epoch || message.columns !== this.columns || message.cell_mm !== this.cell_mm) {
      Object.assign(this, { epoch: message.epoch, columns: message.columns, cell_mm: message.cell_mm, x_mm: message.x_mm, step_mm: message.step_mm, offset_mm: message.offset_mm, begin: message.first });
      this.counts = new Uint16Array(RING * message.columns).fill(UNKNOWN);
      this.end = message.first;
    }
    // rows that were never sent are unknown; the buffer may hold old ones in their place
    for (let row = Math.max(this.end, message.first - RING); row < message.first; row++) this.counts.fill(UNKNOWN, find_slot(row) * this.columns, (find_slot(row) + 1) * this.columns);
    for (let i = 0; i < message.rows; i++) this.counts.set(message.counts.subarray(i * this.columns, (i + 1) * this.columns), find_slot(message.first + i) * this.columns);
    this.end = message.first + message.rows;
    this.begin = Math.max(this.begin, this.end - RING);
    this.changes++;
  }

  get has_rows() { return this.epoch !== null && this.end > this.begin; }

  /** Return the 99.8 % quantile of the heights of the last `rows` rows, mm. */
  find_high_mm(rows) {
    const counts = [];
    for (let row = Math.max(this.begin, this.end - rows); row < this.end; row += 3)
      for (let column = 0; column < this.columns; column += 3) {
        const count = this.counts[find_slot(row) * this.columns + column];
        if (count !== UNKNOWN) counts.push(count & 0x7fff);
      }
    counts.sort((a, b) => a - b);
    return counts.length ? counts[Math.floor((counts.length - 1) * 0.998)] * this.step_mm + this.offset_mm : 0;
  }
}
