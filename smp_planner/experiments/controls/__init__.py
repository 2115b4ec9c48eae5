"""Controls of the tasks: what solves scenes without planning in them.

A fixed detour that never looks at a scene, the unadapted primitive, and actions at random bound
from above how much of a task's success means nothing; the iterations of a single tree search say
how narrow its scenes are.
"""
