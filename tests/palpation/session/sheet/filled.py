"""A session's sheet as a person fills it in."""

FILLED = """\
lab: Motor Lab, 2nd floor
operator: ÅB
subject: S01
ethics: 17-204
phantoms:
  A: {id: P6, batch: 12, cured: 2026-02-28, cure_temperature_c: 22.5}
  B: {id: P7, batch: 12, cured: 2026-03-01, cure_temperature_c: 23}
  C: {id: P8, batch: 13, cured: 2026-03-02, cure_temperature_c: 23}
sensor:
  serial: FT0123
  bias_n_m: -1.5e-3
note: mounted twice
"""
