"""Reports for people: the summary, the figures and the page of a trial.

The report only presents numbers that are in the artefacts. This package imports nothing here, because the drawing
libraries take half a second to load and most commands do not need them.
"""
