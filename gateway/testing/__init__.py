"""What proves a vendor's plugin: the conformance suite, run by `robot-gateway vendor-check` and by tests/conformance.

`conformance` holds the table of checks; the `*_checks` modules hold the checks; `subject`, `vectors`, `readings` and
`streams` are what they stand on. Nothing here knows pytest.
"""
