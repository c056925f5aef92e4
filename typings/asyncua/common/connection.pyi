class TransportLimits:
    def __init__(
        self, max_recv_buffer: int, max_send_buffer: int, max_chunk_count: int, max_message_size: int
    ) -> None: ...
