"""Campaigns: data sets of thousands of measurements that survive anything.

`sweep` reads what is asked, `units` cuts it into units of work named by what they compute, `folder` keeps them,
`engine` computes those that are missing, `results` puts them together. Nothing is imported here, so that
`gonio campaign status` answers at once.
"""
