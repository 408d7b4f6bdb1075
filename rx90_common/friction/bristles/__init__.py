"""Other bristles than LuGre's: elasto-plastic, and Maxwell slip."""
