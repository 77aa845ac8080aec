# For ctest: the tests of crumple_tests that take longer than ten seconds, so that they begin first.
set_tests_properties(
  Http.AReaderThatTakesNothingIsLetGo Http.AHalfRequestAndAnIdleConnectionAreLetGoAndADownloadIsNot
  Links.AServerAHostAndAViewerComeBackWhenTheirRouterIsKilledAndStartedAnewInACrash
  Links.EveryViewerThroughABadLinkEndsWithTheServersSurface
  EndToEnd.OneOfTwoThatStandByGoesOnAndNoneWhoseOwnLineIsCut
  Net.HearsWhomItPrefersWhileAnotherFillsAllThatMayWait
  PROPERTIES COST 30)
