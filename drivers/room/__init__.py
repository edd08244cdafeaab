"""Room of the laboratory: PLC, lamp dimmer, lamp supply and air sensor."""
