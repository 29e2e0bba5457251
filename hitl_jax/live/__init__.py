"""A real person as the human: what they do becomes judgements and actions of one run, step by step.

`person` and `labels` are pure; `session` plays one run, `journal` keeps what was done to it,
`conductor` gives it a pace and `attention` says whether the person is still there, `server` and the
page show it to a browser.
"""
