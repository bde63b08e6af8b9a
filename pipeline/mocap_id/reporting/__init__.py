"""What people look at: the summary, the figures and the page of a trial.

Nothing is computed here that another program would need: the numbers are the artefacts', the report shows them.
Nothing is imported here either, since drawing costs half a second that most commands do not need.
"""
