"""The campaign: kills, damaged inputs, failing disks and crowds, each by the hundred or thousand, with seeds.

`python -m tests.campaign OUT.json` runs it; a sample of it is part of the tests.
"""
