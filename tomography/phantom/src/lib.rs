//! The simulated sheet: loads, scenes, effects; nothing is bent unless a scene asks.
