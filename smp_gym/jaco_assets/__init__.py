"""Making of `envs_assets/jaco`: URDF, visual meshes and link spheres from a description in JSON."""

from smp_gym.optional_packages import require

require("planner", "smp_gym.jaco_assets", "trimesh")
require("bench", "smp_gym.jaco_assets", "rich")
