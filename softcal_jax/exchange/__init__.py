"""Other programs and devices; nothing of the method imports them.

Project files and their commands read through `cad` (STEP and STL) and `camera` (tags on
photographs). Results are written by `inp` (CalculiX, Abaqus), `sofa`, `mujoco` and
`icesl`, and a first project file by `proposal`.
"""
