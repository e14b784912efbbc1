"""A session through the twin, once: what replay, verify, report and archive have in common.

`judgement` runs the samples through the twin and says what came out, and holds Ctrl-C back meanwhile;
`terms` says with which parameters and candidates, those of the session or of files; `verification`
compares a judgement with the verdicts that the session holds. Import from these modules: they are slow to
load, and `--help` is not.
"""
