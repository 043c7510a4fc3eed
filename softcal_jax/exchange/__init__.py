"""Other programs and devices, one folder each; nothing of the method imports them.

What is read stands above the project files, which name it: `cad` (STEP and STL) and
`camera` (tags on photographs). What is written stands below the results: `inp`
(CalculiX, Abaqus), `sofa`, `icesl`, and `proposal`, a first project file.
"""
