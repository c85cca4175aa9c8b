/** The joints of a fitted pose, in the server's order, and the joint before each (hypose.body.ready_bodies). */
const JOINTS: readonly (readonly [string, number])[] = [
  ["pelvis", -1], ["spine", 0], ["chest", 1], ["neck", 2], ["head", 3],
  ["left_clavicle", 2], ["left_shoulder", 5], ["left_elbow", 6], ["left_wrist", 7],
  ["right_clavicle", 2], ["right_shoulder", 9], ["right_elbow", 10], ["right_wrist", 11],
  ["left_hip", 0], ["left_knee", 13], ["left_ankle", 14],
  ["right_hip", 0], ["right_knee", 16], ["right_ankle", 17],
];

export const JOINT_NAMES = JOINTS.map(([name]) => name);
export const PARENTS = JOINTS.map(([, parent]) => parent);

/** Clicked points that are joined by a line in the picture. */
export const LINES: readonly (readonly [string, string])[] = [
  ["head_top", "neck"], ["neck", "right_shoulder"], ["neck", "left_shoulder"],
  ["right_shoulder", "right_elbow"], ["right_elbow", "right_wrist"], ["left_shoulder", "left_elbow"], ["left_elbow", "left_wrist"],
  ["right_shoulder", "right_hip"], ["left_shoulder", "left_hip"], ["right_hip", "left_hip"],
  ["right_hip", "right_knee"], ["right_knee", "right_ankle"], ["right_ankle", "right_big_toe"],
  ["left_hip", "left_knee"], ["left_knee", "left_ankle"], ["left_ankle", "left_big_toe"],
];
