"""Campaigns: data sets of thousands of measurements that survive anything.

`sweep` reads what is asked, `units` cuts it into units of work named by what they compute, `store` keeps them.
`running` computes those that are missing: `queue` hands them out to this process, to `processes` of this machine or to
a `cluster`. `planning` tells beforehand what that takes, `status` how far it is. `results` puts units together,
`dataset` opens all results as one array, `publication` makes a data set of them for an archive. Nothing is imported
here, so that `gonio campaign status` answers at once.
"""
