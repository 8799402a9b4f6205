"""The demo scenes: rendered captures of fixed cameras, with the exact ground truth.

`wbflow demo` calls `files.demo_files` and `files.demo_nights`; `scenes.render` renders one scene in memory.

| file | holds |
| --- | --- |
| `yard` `square` `carpark` `depot` | one scene each: its objects, cameras, lamps and traffic |
| `script` `nights` | the events of each night; the yard rendered with them |
| `scenes` `files` `texts/` | the table of scenes; the files of a demo; its site file and README |

| `parts/` | holds |
| --- | --- |
| `structures` `street` `movers` | façades, containers, cranes; cars, trees, lamps; people and vehicles |
| `ground` `weak` | pavings, gravel, grass; surfaces with weak texture |

| `render/` | holds |
| --- | --- |
| `textures` `paint` `covers` | textures of surfaces, and the functions that paint them |
| `scene` | triangles with textures, and the builder that collects them |
| `cameras` `light` `sensor` | lenses and poses; sun, sky and lamps; exposure, noise, clock, rain |
| `renderer` `photograph` `reference` | rays, texture filter and light; captures and true depth of a scene; its reference cloud |

Units are metres, z up.  All random numbers come from seeded generators, so the same arguments give the same bytes.
"""
