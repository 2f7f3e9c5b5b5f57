"""``python -m kilnflight.project.site``: see `kilnflight.project.site.build.main`."""

from kilnflight.project.site.build import main

raise SystemExit(main())
