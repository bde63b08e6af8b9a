"""Perturbations of a trial by typical errors of a laboratory (thesis 5.5.2), and the levels that it tolerates.

`perturbations` lists the kinds of perturbation and changes the inputs of the stages. `runs` runs the stages that depend
on these inputs and compares the results. `study` plans the perturbations, finds the tolerated levels, and writes tables
and page.
"""
