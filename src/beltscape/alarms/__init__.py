"""Alarms for the operator: limits with hysteresis and delays, latching, acknowledgement.

`readings` and `settings` enter `rules`, which give each alarm's condition; `board` keeps the state of every alarm.
"""
