// A simulated room of 8 x 6 m with a wall across it that has a door, and scans of it: what a robot with a perfect scanner would send.

const BEAMS = 360;
const [POSE_ERROR, HEADING_ERROR] = [0.02, 0.005];

export const WALLS = [[0, 0, 8, 0], [8, 0, 8, 6], [8, 6, 0, 6], [0, 6, 0, 0], [4, 0, 4, 2], [4, 3.4, 4, 6]];

/** A crate that someone puts into the left half. */
export const CRATE = [[1, 4, 1.8, 4], [1.8, 4, 1.8, 4.8], [1.8, 4.8, 1, 4.8], [1, 4.8, 1, 4]];

export const SENSOR = { range_max: 20 };

const WAY = [[1.5, 1.5], [2.6, 2.7], [5.4, 2.7], [6.5, 4.5], [6.5, 1.5], [5.4, 2.7], [2.6, 2.7], [1.5, 3.2]];

export function scan(x, y, theta, walls = WALLS) {
  const interval = (value, error) => ({ min: value - error, max: value + error });
  return {
    robot: 'amr-7',
    pose: { x: interval(x, POSE_ERROR), y: interval(y, POSE_ERROR), theta: interval(theta, HEADING_ERROR) },
    angle_min: 0,
    angle_increment: (2 * Math.PI) / BEAMS,
    ranges: Array.from({ length: BEAMS }, (_, beam) => range(x, y, theta + (2 * Math.PI * beam) / BEAMS, walls)),
    footprint_radius: 0.25,
  };
}

/** Scans along the way through both halves. */
export function drive(steps, walls = WALLS) {
  const scans = [];
  for (let leg = 0; leg + 1 < WAY.length; leg++) {
    const [[ax, ay], [bx, by]] = [WAY[leg], WAY[leg + 1]];
    for (let step = 0; step < steps; step++) {
      const part = step / steps;
      scans.push(scan(ax + (bx - ax) * part, ay + (by - ay) * part, Math.atan2(by - ay, bx - ax), walls));
    }
  }
  return scans.map((one, at) => ({ ...one, sequence: String(at + 1) }));
}

/** The nearest wall along a ray. */
function range(x, y, angle, walls) {
  const [dx, dy] = [Math.cos(angle), Math.sin(angle)];
  let nearest = 'Infinity';
  for (const [x1, y1, x2, y2] of walls) {
    const [ex, ey] = [x2 - x1, y2 - y1];
    const cross = dx * ey - dy * ex;
    if (Math.abs(cross) < 1e-12) continue;
    const along = ((x1 - x) * ey - (y1 - y) * ex) / cross;
    const share = ((x1 - x) * dy - (y1 - y) * dx) / cross;
    if (along > 0 && share >= 0 && share <= 1 && !(nearest < along)) nearest = along;
  }
  return nearest;
}
