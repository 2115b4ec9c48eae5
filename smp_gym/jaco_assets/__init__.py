"""Making of `envs_assets/jaco`: URDF, visual meshes and link spheres from a description in JSON."""
