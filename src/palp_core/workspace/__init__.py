"""The rig as an installed workspace: what is in ``nodes``, ``msgs`` and ``launch`` of palp's own repository.

An installed palp has the three folders beside this file; an editable install uses the checkout's. Wherever
one is, ``palp launch rig:sim.yaml`` runs the rig, and its classes are there to derive from::

    from palp_core.workspace.nodes.policy import PolicyNode

A module has one identity: that is ``nodes.policy``, as the launch files of the rig call it.
"""

from palp_core.graph.workspaces.modules import install_finders

install_finders()
