"""The paper's method: every auxiliary forms a rectified pair with the core, and the pairs' depths are averaged."""
