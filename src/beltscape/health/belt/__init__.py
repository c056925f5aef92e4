"""Checks of heights against the learned empty belt.

``cells`` reduces a depth map to the robust heights of small cells over the learned belt. ``zero_shift`` finds the
bare belt among them and estimates its rigid motion since it was learned; ``zero_finding`` judges it, and
``zero_history`` averages it over frames. ``zero_setting`` moves the learned belt by it, on the operator's request.
``carry_back`` and ``passes`` follow what is stuck to the belt over its revolutions.
"""
