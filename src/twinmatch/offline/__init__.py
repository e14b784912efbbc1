"""Judging a session: the common part of replay, verify, report and archive.

`judgement` runs the samples through the twin and collects the results, deferring Ctrl-C meanwhile; `terms`
determines parameters and candidates, recorded ones or those of files; `verification` compares a judgement
with the recorded verdicts. Import from these modules, not from the package: they are slow to load, and
`--help` must be fast.
"""
