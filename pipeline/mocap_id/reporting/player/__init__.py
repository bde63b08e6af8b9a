"""The page's player: the chain over its markers, moment by moment, beside the wrench and the centre of pressure.

Bokeh draws in the browser, from a script that its wheel brings and the page holds; the slider and the buttons are the
browser's own. Where the data do not suffice for a player, the page does without.
"""
