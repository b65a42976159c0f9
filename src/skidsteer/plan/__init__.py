"""Plans: known manoeuvres to wheel commands, and where they lead. Giannoccaro 2015, section V."""
