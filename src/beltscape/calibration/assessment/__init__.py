"""Assessment of a rig: `uncertainty`, `domain`, `validation` and `findings`, in this order; `diagnosis` joins them."""
