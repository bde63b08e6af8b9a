"""Perturbations of a trial by typical errors of a laboratory (thesis 5.5.2), and the levels that it tolerates.

`perturbations` lists the kinds of perturbation, changes the inputs of the stages, and reads what a user asks for.
`study` runs the stages that depend on these inputs, finds the tolerated levels, and writes tables and page.
"""
