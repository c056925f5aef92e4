"""Material tests and their certificates: from a test's file and a plant's history to a signed document in force.

`stretches` are what was measured of a run, `material_test` evaluates a test's file, `test_object` the quick form;
`certificates` keeps, signs and finds them, `verification` checks one.
"""
