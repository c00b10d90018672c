"""Many runs: in processes of this machine or on a cluster, kept as they are done."""
