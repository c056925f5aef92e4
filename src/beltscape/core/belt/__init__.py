"""The belt: its frame and height map, the empty belt, flow records and ledger entries."""
