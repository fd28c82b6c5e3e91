// Where a map has contents, found by going down the quadtree from the root.

import { type Bounds, type Leaf, getRegion } from './api';
import type { Grid } from './grid';

const STEP = 2;

/** Nodes of one look that are few enough to look closer. */
const MOST = 4000;

/** A box that holds everything that is not unknown; null for an empty map. */
export async function mapped(grid: Grid): Promise<Bounds | null> {
  const { name, bounds, config, unknown_class: unknown } = grid.map;
  let box = bounds;
  for (let depth = Math.min(6, config.depth); ; depth = Math.min(depth + STEP, config.depth)) {
    const leaves = await getRegion(name, null, box, depth);
    const deepest = depth === config.depth;
    // A node that is cut shows its maximum, which may be unknown though some of it is free.
    const there = leaves.filter((leaf) => leaf.class !== unknown || (!deepest && leaf.depth === depth && depth > 0));
    if (there.length === 0) return null;
    const found = around(grid, there);
    if (deepest || there.length > MOST) return found;
    box = found;
  }
}

function around(grid: Grid, leaves: Leaf[]): Bounds {
  const box = { min_x: Infinity, min_y: Infinity, max_x: -Infinity, max_y: -Infinity };
  for (const leaf of leaves) {
    const node = grid.node(leaf.depth, leaf.x, leaf.y);
    box.min_x = Math.min(box.min_x, node.min_x);
    box.min_y = Math.min(box.min_y, node.min_y);
    box.max_x = Math.max(box.max_x, node.max_x);
    box.max_y = Math.max(box.max_y, node.max_y);
  }
  return box;
}
