"""The projector's speckle pattern: its generation, images, description and quality."""
