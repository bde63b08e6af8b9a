"""Summaries, tables, figures and pages of trials and studies, and the explanations of all reason codes.

The report only presents numbers that are in the artefacts. This package imports nothing here, because the drawing
libraries take half a second to load and most commands do not need them.
"""
