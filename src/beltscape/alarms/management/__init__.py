"""The management of alarms by ANSI/ISA-18.2 and IEC 62682: priorities, first-out, suppression, texts, statistics."""
