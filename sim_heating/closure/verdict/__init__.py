"""What is stated of a record: how well a model explains it, and how sure a finding is."""
