"""Sources of telemetry: asynchronous iterators of messages, and decoders that a journal is read with again.

A source is a decoder of bodies with a way in which bodies come. The journal keeps bodies; what they mean is decided by
the decoder each time they are read.
"""

from __future__ import annotations

from sim_heating.live.sources.source import Remark, SourceStream, check_sources, decoder_of, open_source

__all__ = ["Remark", "SourceStream", "check_sources", "decoder_of", "open_source"]
