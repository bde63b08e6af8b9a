"""Perturbations of a trial by typical errors of a laboratory (thesis 5.5.2), and the levels that it tolerates.

`kinds` lists the kinds of perturbation, and `plan` makes the list to run from the user's options. The modules
`signal_perturbations` and `marker_perturbations` change the inputs of the stages, which `trial_inputs` reads. `runs`
runs the stages that depend on these inputs. `responses` compares the results, `tolerance` determines the tolerated
levels, and `study` writes `tables` and page.
"""
