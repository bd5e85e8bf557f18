"""What both ends share: messages, codecs, geometry, the stream table, the clock."""
