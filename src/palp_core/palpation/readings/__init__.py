"""Readings of anybody's experiment: who can tell which class from what was felt, and how sure may one be.

Neither rig nor ring nor depth is needed: classes, settings and trials are names, a reading is one number or
several. In Python::

    from palp_core.palpation.readings.analysis import Plan, analyse
    from palp_core.palpation.readings.readings import Readings

    readings = Readings.of(values, classes, settings=actions, trials=trials)
    record = analyse(readings, Plan(policies=("recorded", "information_gain")))
"""
