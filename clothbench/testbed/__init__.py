"""A table-top testbed made up for suites: a strip of cloth on a desk, a gripper slightly off, a laser camera.

Nothing here shares a line with a model: the strip is an inextensible heavy elastica solved by collocation.
"""
