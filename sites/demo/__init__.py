"""The demo scenes: rendered captures of fixed cameras, with the exact truth beside them.

`files.demo_files` and `files.demo_nights` are what `wbflow demo` calls; `scenes.render` gives the same in memory.

| file | holds |
| --- | --- |
| `yard` `square` `carpark` `depot` | one scene each: what stands where, its cameras, lamps and traffic |
| `script` `nights` | what happens night after night, and the yard rendered with it |
| `scenes` `files` `texts/` | the table of scenes; the files of a demo; its site file and README |

| `parts/` | holds |
| --- | --- |
| `structures` `street` `movers` | façades, containers, cranes; cars, trees, lamps; people and vehicles |
| `ground` `weak` | pavings, gravel, grass; surfaces on which little is to be seen |

| `render/` | holds |
| --- | --- |
| `textures` `paint` `covers` | what surfaces look like, and what they are painted with |
| `scene` | triangles with textures, and the builder that collects them |
| `cameras` `light` `sensor` | lenses and places; sun, sky and lamps; exposure, noise, clock, rain |
| `renderer` `photograph` `reference` | rays, texture filter and light; captures and true depth of a scene; its true cloud |

All is in metres, z up; whatever is random comes from seeded generators, so that the same arguments give the same bytes.
"""
