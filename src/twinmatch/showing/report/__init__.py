"""A judged session as a document to share: one HTML file, and its figures.

`report.make_report` judges a session again, whether or not verdicts were recorded, and collects the content;
`SessionReport.write` lays it out as one file that loads nothing else, needs no script and prints well.
`pictures.write_pictures` writes the figures as separate files. The content comes from `twinmatch.showing`, as
on the live page and the terminal, so that all of them show the same values.
"""
