// The colour map of heights: viridis (CC0, S. van der Walt and N. Smith), perceptually uniform and safe for colour-blind users.
const STOPS = [[68, 1, 84], [72, 26, 108], [71, 47, 125], [65, 68, 135], [57, 86, 140], [49, 104, 142], [42, 120, 142], [35, 136, 142], [31, 152, 139], [34, 168, 132], [53, 183, 121], [84, 197, 104], [122, 209, 81], [165, 219, 54], [210, 226, 27], [253, 231, 37]];

/** Return [r, g, b] of a share 0..1. */
export function viridis(share) {
  const at = Math.min(Math.max(share, 0), 1) * (STOPS.length - 1);
  const low = Math.min(Math.floor(at), STOPS.length - 2);
  return STOPS[low].map((value, i) => value + (STOPS[low + 1][i] - value) * (at - low));
}

/** Return the colour map as RGBA bytes in n steps. */
export function create_table(n) {
  return Uint8Array.from({ length: n * 4 }, (_, i) => (i % 4 === 3 ? 255 : Math.round(viridis((i >> 2) / (n - 1))[i % 4])));
}
