"""The radio: who hears whom, how much goes on the air, and the ledger of every byte."""
