"""Plans: wheel commands for known manoeuvres, and where they lead. Giannoccaro 2015, section V."""
