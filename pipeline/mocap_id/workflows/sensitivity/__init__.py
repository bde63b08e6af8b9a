"""A trial perturbed in every way that a lab meets (thesis 5.5.2), and what its result tolerates.

`kinds` says what there is, `plan` which of it is tried, `asking` reads what the user wants; `signals` and `markers`
change the inputs, `changing` runs the stages that see the change, `trying` does it in processes; `responses` compares,
`tolerance` finds where it becomes too much, `tables` and `writing` tell.
"""
