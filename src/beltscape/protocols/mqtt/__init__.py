"""MQTT 5: records, state and alarms to a broker, as JSON or by Sparkplug B.

`publisher` is the thread that connects and publishes; the historian is its outbox, and its cursor on the disk
says up to which record they have arrived at the broker. A channel is one session: `json_channel`, or
`sparkplug` with the messages of `sparkplug_payload`; `connection` is what both share.
"""
