"""Results of studies in a common form: declared columns, tables, and files that are written together.

`columns` declares and fills tables, `result` writes them with their JSON document, `grid_columns` shows rows as text,
`page` renders the page, and `trial_entries` says in words how each trial ended.
"""
