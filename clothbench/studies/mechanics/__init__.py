"""Models held against mechanics: scenes whose answer is known, what is measured in them, and the answers.

`references` has the answers, `scenes` builds what is simulated, `measures` reads the result, `checks` lists the tests
and `subject` runs a model through one of them. Uses the public names of `clothbench` alone, as a plugin does.
"""

VERSION = 3  # raised whenever a scene, a measure or a reference changes: results of another version are set aside
