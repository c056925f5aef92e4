"""The projector's speckle pattern: generated, drawn, described, judged."""
