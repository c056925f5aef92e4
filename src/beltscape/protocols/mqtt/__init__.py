"""MQTT 5: records, state and alarms as JSON to a broker.

`publisher` is the thread that connects and publishes; the historian is its outbox, and `cursor` keeps on the disk up
to which record the broker has acknowledged. `payloads` forms the JSON, `settings` is the table [mqtt].
"""
