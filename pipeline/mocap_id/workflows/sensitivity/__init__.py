"""A trial perturbed in the ways that occur in a laboratory (thesis 5.5.2), and the perturbations that it tolerates.

`kinds` lists the perturbations, `options` reads the user's choice, and `plan` makes the list to run. The modules
`signal_perturbations` and `marker_perturbations` change the inputs, `perturbed_trial` runs the stages that depend on
them, and `runs` does so in parallel. `responses` compares the results, `tolerance` finds the tolerated levels, and
`study` writes `tables` and page.
"""
