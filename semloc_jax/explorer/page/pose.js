// The pose as six numbers, moved in the frame of the vehicle; angles in degrees.

export const DIRECTIONS = ["x", "y", "z", "roll", "pitch", "yaw"];
export const NAMES = { x: "forward", y: "left", z: "height", roll: "roll", pitch: "pitch", yaw: "heading" };
export const UNITS = { x: "m", y: "m", z: "m", roll: "°", pitch: "°", yaw: "°" };
export const LIMITS = { z: 0.5, roll: 3, pitch: 3 };
const FIELDS = { z: "height_m", roll: "roll_deg", pitch: "pitch_deg" };

const rad = (degrees) => (degrees * Math.PI) / 180;
export const turn = (degrees) => ((((degrees + 180) % 360) + 360) % 360) - 180;

// The pose after a step along directions of its own frame, e.g. {x: 0.1, yaw: -1}.
export function moved(pose, step) {
  const c = Math.cos(rad(pose.yaw_deg)), s = Math.sin(rad(pose.yaw_deg));
  const dx = step.x || 0, dy = step.y || 0, next = { ...pose };
  next.x_m += c * dx - s * dy;
  next.y_m += s * dx + c * dy;
  next.yaw_deg = turn(next.yaw_deg + (step.yaw || 0));
  for (const [name, field] of Object.entries(FIELDS)) {
    if (step[name]) next[field] = Math.min(Math.max(next[field] + step[name], -LIMITS[name]), LIMITS[name]);
  }
  return next;
}

export const standing = (pose, name) => pose[FIELDS[name]];
export const withStanding = (pose, name, value) => ({ ...pose, [FIELDS[name]]: value });

// Where a pose is, seen from a reference: forward, left [m], heading [deg].
export function offset(pose, reference) {
  const c = Math.cos(rad(reference.yaw_deg)), s = Math.sin(rad(reference.yaw_deg));
  const dx = pose.x_m - reference.x_m, dy = pose.y_m - reference.y_m;
  return { x: c * dx + s * dy, y: c * dy - s * dx, yaw: turn(pose.yaw_deg - reference.yaw_deg) };
}
