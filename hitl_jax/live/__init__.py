"""A real person as the human: their judgements and actions enter one run, step by step.

`person` and `labels` are pure functions of the team. `session` plays one run, `live_person` keeps
what the person said and controls, and `journal` writes it down. `pacing` plays a session in real
time, `silence_timer` notices a page that stopped answering, and `server` connects browsers to it;
`messages` come from a page and `page_updates` go to it.
"""
